"""Completion within quotes, in notebooks: what is offered where."""

import pytest

from labbook import completion
from labbook.fit import LAWS
from labbook.measure import MEASURES


class Drawn:
    """Results with two figures."""

    def figures(self) -> tuple[str, ...]:
        return ("flow_rate", "against_fan2023")


def offered(text: str) -> list[str]:
    return completion.offered(text, {"results": Drawn()})[1]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('results.plot("', ["against_fan2023", "flow_rate"]),
        ("results.plot('fl", ["flow_rate"]),
        ('results.fit("', sorted(LAWS)),
        ('other.plot("', []),
        ('define(measure=["', sorted(MEASURES)),
        ('define(fit="janda_', ["janda_3d"]),
        ('define({"gra', ["grains", "gravity"]),
        ('labbook.define(name="a", grains={"diameter": "3 mm", "co', ["count"]),
        ('define(grains={"shape": "sphere"}, contact={\n  "law": "hertz-m', ["hertz-mindlin"]),
        ('define(fill={"contact": {"rolling_model": "', ["cdt", "epsd"]),
        ('define(grains={"kinds": [{"name": "a"}, {"sh', ["share", "shear_modulus"]),
        ('define(container={"kind": "primitives", "parts": [{"shape": {"ki', ["kind"]),
        ('define(sweep={"container.or', ["container.orifice"]),
        ('define(sweep={"container.orifice": ["', []),
        ('define(points=[{"container.or', ["container.orifice"]),
        ('study.change({"contact.friction": 0.3, "container.or', ["container.orifice"]),
        ('study.change({"sweep.container.or', ["sweep.container.orifice"]),
        ('results.fit("janda", at={"container.an', ["container.angle"]),
        ('print("gra', []),
        ("define(gra", []),
        ('define(name="a")', []),
    ],
)
def test_words_are_those_that_may_stand_at_the_cursor(text, words):
    assert offered(text) == words


def test_a_shell_of_ipython_offers_them():
    pytest.importorskip("IPython")
    from IPython.core.completer import provisionalcompleter  # pyright: ignore[reportMissingImports]
    from IPython.core.interactiveshell import InteractiveShell  # pyright: ignore[reportMissingImports]

    shell = InteractiveShell()
    shell.run_cell("%load_ext labbook\nimport labbook")

    def completed(code: str) -> list[str]:
        with provisionalcompleter():
            return [one.text for one in shell.Completer.completions(code, len(code))]

    assert completed("labbook.define(gra") == ["grains=", "gravity="]
    assert completed('labbook.define(grains={"co') == ["count"]
