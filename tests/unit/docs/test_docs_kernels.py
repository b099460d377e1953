"""The session with a debugger of docs/kernels.md gives what the page says."""

import re
import subprocess
import sys

import pytest
from toy_lab import ROOT

PAGE = (ROOT / "docs/kernels.md").read_text(encoding="utf-8")


@pytest.mark.slow
def test_the_session_with_a_debugger_is_as_printed(tmp_path):
    blocks = re.findall(r"```(\w*)\n(.*?)```", PAGE, flags=re.DOTALL)
    (program,) = (text for language, text in blocks if language == "python" and "bounce" in text)
    (session,) = (text for _, text in blocks if "(Pdb)" in text)
    (tmp_path / "drop.py").write_text(program, encoding="utf-8")
    lines = session.splitlines()
    typed = [line.removeprefix("(Pdb) ") for line in lines if line.startswith("(Pdb)")]
    ended = subprocess.run(
        [sys.executable, "-m", "pdb", "drop.py"],
        input="\n".join(typed) + "\n", capture_output=True, text=True, cwd=tmp_path, timeout=120,
    )  # fmt: skip
    shown = [line.removeprefix("(Pdb) ").strip() for line in ended.stdout.splitlines()]
    at = 0
    for line in (line for line in lines if not line.startswith("(Pdb)")):
        assert line in shown[at:], f"after {shown[:at][-3:]}"
        at += shown[at:].index(line) + 1


def test_the_modules_that_the_page_calls_symbolic_are_there():
    from importlib import import_module

    for name in ("labbook_dem.words", "labbook_dem.chosen"):
        assert f"`{name}`" in PAGE
        import_module(name)
    for name in ("labbook_numba.kernels.shape", "labbook_warp.kernels.shape", "labbook_warp.kernels.shown"):
        module = import_module(name)
        assert module.__doc__ is not None
        assert "Nothing here is compiled" in module.__doc__
