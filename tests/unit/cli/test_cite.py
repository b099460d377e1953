"""`labbook cite` names the sources of what a study uses, and CITATION.cff is right."""

import json
import re
import tomllib
from pathlib import Path

import pytest
from ruamel.yaml import YAML
from typer.testing import CliRunner, Result

from labbook.cli import build
from labbook.filling.placing import STARTS
from labbook.fit import LAWS
from labbook.measure import MEASURES
from labbook.scene.contact import CONTACT_LAWS, ContactLaw
from labbook.sources import CONTACT_LAWS as SOURCES_OF_LAWS
from labbook.sources import MEASURES as SOURCES_OF_MEASURES
from labbook.sources import METHODS, PAPER_FITS, ROLLING_MODELS, SOURCES, Source, named_in
from labbook.sources import STARTS as SOURCES_OF_STARTS
from labbook.study import define, load
from labbook.study.citing import AUTHORS, bibliography
from labbook.study.paper import PAPERS, fits
from labbook.version import __version__

ROOT = Path(__file__).parents[3]
STUDIES = sorted((ROOT / "studies").glob("*.yaml"))
ENTRY = re.compile(r"^@(?:article|book|misc)\{([^,\s]+),\n((?:  \w+ = \{.*\},\n)+)\}$", re.MULTILINE)


def cite(*words: object) -> Result:
    return CliRunner().invoke(build(), ["cite", *map(str, words)])


def sources_of(*words: object) -> dict[str, list[str]]:
    """What each source is cited for, by its key, in the order printed."""
    done = cite(*words, "--json")
    assert done.exit_code == 0, done.output
    return {one["key"]: one["for"] for one in json.loads(done.stdout)["sources"]}


def hopper(**keys: object) -> dict[str, object]:
    """A small study in Python."""
    return {
        "name": "small",
        "grains": {"shape": "sphere", "diameter": "3 mm", "density": "2500 kg/m^3", "count": 500},
        "contact": {
            "law": "hertz-mindlin",
            "shear_modulus": "5 MPa",
            "poisson_ratio": 0.25,
            "friction": 0.5,
            "restitution": 0.5,
        },
        "container": {
            "kind": "wedge-hopper",
            "width": "60 mm",
            "height": "200 mm",
            "thickness": "1.01 d",
            "angle": "90 deg",
            "orifice": "24 mm",
        },
        **keys,
    }


def keys_of(**keys: object) -> list[str]:
    return [one.source.key for one in bibliography(define(hopper(**keys))).citations]


@pytest.mark.parametrize("path", STUDIES, ids=lambda path: path.stem)
def test_every_study_names_labbook_and_its_contact_laws(path):
    found = bibliography(load(path))
    assert found.citations[0].source.key == "labbook"
    assert not found.unsourced
    uses = {use for one in found.citations[1:] for use in one.uses}
    laws = {point.scene.contact.law for point in load(path).points}
    assert {f"contact law {law}" for law in laws} <= uses
    text = path.read_text(encoding="utf-8")
    assert {f"contact law {law}" for law in re.findall(r"\blaw: ([\w-]+)", text)} <= uses
    assert {f"fit {name}" for name in load(path).fit} <= uses


@pytest.mark.parametrize(
    ("study", "keys"),
    [
        (
            "quickstart",
            "labbook hertz1882 tsuji1992 mindlin1953 fan2023 nelson1979 goldhirsch2010 beverloo1961 venzon1988",
        ),
        ("dosta2024-silo", "labbook hertz1882 tsuji1992 kloss2012 dosta2024"),
        ("pongo2022-fields", "labbook cundall1979 pongo2022 ericson2005 goldhirsch2010"),
    ],
)
def test_a_study_cites_what_it_uses_and_nothing_else(study, keys):
    assert list(sources_of(ROOT / f"studies/{study}.yaml")) == keys.split()


def test_methods_are_cited_only_if_used():
    plain = keys_of()
    assert plain == ["labbook", "hertz1882", "tsuji1992", "mindlin1953", "fan2023"]
    assert set(keys_of(fit=["beverloo"])) - set(plain) == {"beverloo1961", "venzon1988"}
    assert set(keys_of(fit=["beverloo", "janda"])) - set(keys_of(fit=["beverloo"])) == {"janda2012", "hurvich1989"}
    steps = {"numerics.dt": ["10 us", "5 us"]}
    assert keys_of(sweep=steps) == plain
    assert set(keys_of(sweep=steps, accuracy={"numerics": "5 %"})) - set(plain) == {"schuirmann1987"}
    assert keys_of(accuracy={"numerics": "5 %"}) == plain
    angles = {"container.angle": ["30 deg", "90 deg"]}
    assert set(keys_of(sweep=angles)) - set(plain) == {"brown1961", "rose1959"}
    assert keys_of(sweep={"container.angle": ["30 deg", "60 deg"]}) == plain


def test_sizes_by_mass_name_the_source_of_their_conversion():
    sizes = {"kind": "lognormal", "median": "2 mm", "spread": 0.3, "smallest": "1 mm"}
    grains = {"shape": "sphere", "diameter": "3 mm", "density": "2500 kg/m^3", "count": 600}
    assert keys_of(grains={**grains, "sizes": sizes}) == keys_of()
    assert set(keys_of(grains={**grains, "sizes": {**sizes, "by": "mass"}})) - set(keys_of()) == {"hatch1929"}


def test_the_law_of_the_filling_is_cited_too():
    slippery = {"law": "hertz-liggghts", "shear_modulus": "5 MPa", "poisson_ratio": 0.25, "restitution": 0.5}
    assert set(keys_of(fill={"contact": slippery})) - set(keys_of()) == {"kloss2012"}


def test_rolling_friction_names_the_source_of_its_model():
    contact = {"law": "linear", "normal_stiffness": "1000 N/m", "restitution": 0.9, "rolling_friction": 0.1}
    uses = [use for use, _ in _uses_of(contact)]
    assert "rolling friction cdt" in uses
    assert ("rolling friction epsd", "ai2011") in _uses_of({**contact, "rolling_model": "epsd"})
    assert not any(use.startswith("rolling") for use, _ in _uses_of({**contact, "rolling_friction": 0}))
    assert ("restitution of the law linear", "schwager2007") in _uses_of(contact)
    assert not any(key == "schwager2007" for _, key in _uses_of({**contact, "damping": "textbook"}))


def _uses_of(contact: dict[str, object]) -> list[tuple[str, str]]:
    found = bibliography(define(hopper(contact=contact)))
    return [(use, one.source.key) for one in found.citations for use in one.uses]


def test_all_that_is_built_in_has_an_entry():
    assert set(SOURCES_OF_LAWS) == set(CONTACT_LAWS)
    assert set(SOURCES_OF_MEASURES) == set(MEASURES)
    assert set(SOURCES_OF_STARTS) == set(STARTS)
    assert set(PAPER_FITS) == set(fits())
    assert set(PAPERS) <= set(SOURCES)
    annotation = ContactLaw.model_fields["rolling_model"].annotation
    assert set(ROLLING_MODELS) == set(getattr(annotation, "__args__", ()))
    for table in (SOURCES_OF_LAWS, SOURCES_OF_MEASURES, SOURCES_OF_STARTS, PAPER_FITS, ROLLING_MODELS, METHODS):
        for name, keys in table.items():
            assert set(keys) <= set(SOURCES), name
    assert all(SOURCES_OF_LAWS.values())


def test_the_source_texts_of_fits_name_publications_that_are_known():
    for law in LAWS.values():
        assert all(one.key in SOURCES for one in named_in(law.source)), law.name
    assert [one.key for one in named_in(LAWS["beverloo"].source)] == ["beverloo1961", "fan2023"]


def test_every_source_is_used_and_is_named_after_its_author_and_year():
    tables = (SOURCES_OF_LAWS, SOURCES_OF_MEASURES, SOURCES_OF_STARTS, PAPER_FITS, ROLLING_MODELS, METHODS)
    used = {key for table in tables for keys in table.values() for key in keys}
    used |= {one.key for law in LAWS.values() for one in named_in(law.source)}
    used |= {one.key for path in STUDIES if (told := load(path).reference) for one in named_in(told.source)}
    assert used >= set(SOURCES)
    assert used - set(SOURCES) == {"validation-scripts-of-project-chrono-s"}  # an experiment without a publication
    for key, one in SOURCES.items():
        assert [key] == [found.key for found in named_in(f"{one.authors[0]} et al. {one.year}")]


def test_sources_of_texts():
    assert [one.key for one in named_in("Pongó et al. 2022")] == ["pongo2022"]
    assert [one.key for one in named_in("Pongo et al. 2022; kappa = 0.084/mm")] == ["pongo2022"]
    (unknown,) = named_in("Nobody & Others, J. None 3 (2019) 7")
    assert unknown == Source("nobody-others-j-none-3-2019", "Nobody & Others, J. None 3 (2019) 7")
    known, other = named_in("Fan et al. 2023, eq 1; Nobody 2020")
    assert (known.key, other.title) == ("fan2023", "Nobody 2020")
    assert [one.title for one in named_in("Fan et al. 2022")] == ["Fan et al. 2022"]
    assert [one.title for one in named_in("own measurements")] == ["own measurements"]


def test_a_fit_of_another_package_shows_its_source(monkeypatch):
    law = type(LAWS["power"])
    monkeypatch.setattr(law, "source", "Nobody 2020")
    found = bibliography(define(hopper(fit=["power"])))
    assert ("Nobody 2020", ("fit power",)) in [(one.source.title, one.uses) for one in found.citations]
    monkeypatch.setattr(law, "source", "")
    assert bibliography(define(hopper(fit=["power"]))).unsourced == ("fit power",)


@pytest.mark.parametrize("path", STUDIES, ids=lambda path: path.stem)
def test_bibtex_can_be_read(path):
    done = cite(path, "--bibtex")
    assert done.exit_code == 0, done.output
    keys = [key for key, _ in entries(done.stdout)]
    assert keys == list(sources_of(path))
    assert len(set(keys)) == len(keys)


def entries(text: str) -> list[tuple[str, dict[str, str]]]:
    """Keys and fields of a BibTeX file; fails for anything between entries, and for braces that do not match."""
    assert not ENTRY.sub("", text).strip()
    found = []
    for key, body in ENTRY.findall(text):
        fields = dict(re.findall(r"^  (\w+) = \{(.*)\},$", body, re.MULTILINE))
        for value in fields.values():
            depth = 0
            for letter in value:
                depth += {"{": 1, "}": -1}.get(letter, 0)
                assert depth >= 0, value
            assert depth == 0, value
        found.append((key, fields))
    return found


def test_bibtex_of_text_from_a_study(tmp_path):
    path = tmp_path / "odd.yaml"
    text = (ROOT / "studies/quickstart.yaml").read_text(encoding="utf-8")
    reference = "'Nobody} \\ & 100 % {Łódź_#1~^ Pongó 1999'"
    path.write_text(f"{text}\nreference:\n  source: {reference}\n  beverloo.k: {{value: 1.5}}\n", encoding="utf-8")
    done = cite(path, "--bibtex")
    assert done.exit_code == 0, done.output
    last, fields = entries(done.stdout)[-1]
    assert last.startswith("nobody-100")
    assert fields["title"].isascii()
    assert r"Nobody\textbraceright{} \textbackslash{} \& 100 \% \textbraceleft{}{\L}{\'o}d{\'z}" in fields["title"]


def test_names_of_groups_are_not_taken_apart():
    (_, fields), *_ = entries(cite(ROOT / "studies/quickstart.yaml", "--bibtex").stdout)
    assert fields["author"] == "{The labbook authors}"


def test_an_unknown_file_gives_the_usual_error():
    cited, planned = cite("no-such-study.yaml"), CliRunner().invoke(build(), ["plan", "no-such-study.yaml"])
    assert cited.exit_code == planned.exit_code == 1
    assert "no-such-study.yaml" in cited.stderr
    assert cited.stderr == planned.stderr
    assert not cited.stdout


def test_two_formats_exclude_each_other():
    done = cite(ROOT / "studies/quickstart.yaml", "--bibtex", "--json")
    assert done.exit_code == 1
    assert "give one of them" in done.stderr


def test_citation_cff_says_what_the_project_says():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    cff = YAML(typ="safe").load((ROOT / "CITATION.cff").read_text())
    assert cff["cff-version"] == "1.2.0"
    assert cff["type"] == "software"
    assert (cff["title"], cff["version"], cff["license"]) == (project["name"], __version__, project["license"])
    authors = [author["name"] for author in project["authors"]]
    assert [author["name"] for author in cff["authors"]] == authors == [AUTHORS]
    assert cff["message"]


def test_the_page_shows_what_is_printed():
    page = (ROOT / "docs/cite.md").read_text(encoding="utf-8")
    study = ROOT / "studies/quickstart.yaml"
    for language, options in (("text", []), ("bibtex", ["--bibtex"])):
        printed = cite(study, *options).stdout
        shown = re.findall(rf"^```{language}\n(.*?)^```", page, re.DOTALL | re.MULTILINE)
        assert shown, language
        assert all(part.strip() in printed for block in shown for part in block.split("...\n"))
