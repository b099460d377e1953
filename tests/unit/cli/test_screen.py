"""What verbs print on terminals of any encoding, and in pipes."""

import os
import shutil

import pytest
from toy_lab import APP, carry_out, labbook, study_file
from typer.testing import CliRunner

from labbook.cli.screen import plain
from labbook.study import load


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """A lab with runs of a study and a study file, of a name that is long."""
    folder = tmp_path_factory.mktemp("screen")
    path = study_file(folder, "fit: [beverloo, janda]", count=400, orifices="[18, 21, 24, 30]", replicates=2)
    carry_out(load(path), folder / "lab")
    shutil.copytree(folder / "lab", folder / "other")
    return folder, path


@pytest.mark.parametrize(("text", "shown"), [
    ("W = 3.1 ± 0.2 g/s, −∞", "W = 3.1 +- 0.2 g/s, -inf"), ("18.2 µs", "18.2 us"), ("mm²", "mm^2"),
    ("7.3 × 10⁻¹² m", "7.3 x 10^-12 m"), ("φ, Ω, ς, μ_r", "phi, Omega, sigma, mu_r"),
    ("Pongó, Łódź, Größe", "Pongo, Lodz, Grosse"),
    ("30°", "30 deg"), ("⟨v⟩ ≥ 0 … Student’s t – or", "<v> >= 0 ... Student's t - or"), ("s₁", "s1"), ("日", "?"),
    ("\ufffd", "?"),
])  # fmt: skip
def test_signs_have_plain_ones_in_their_place(text, shown):
    assert plain(text) == shown


VERBS = (
    ("plan", "STUDY"), ("fit", "STUDY"), ("runs",), ("runs", "--json"), ("status",), ("show", "KEY"), ("show", "none"),
    ("show", "KEY", "--json"), ("cite", "STUDY"), ("cite", "STUDY", "--bibtex"), ("report", "STUDY"), ("run", "STUDY"),
    ("export", "STUDY"), ("reindex",), ("import", "OTHER"), ("stress", "--list"), ("verify", "--list"), ("--help",),
    ("slurm", "STUDY", "--tasks", "2", "--time", "1:00:00"), ("plan", "nowhere µ.yaml"), ("plan", "\udcff.yaml"),
    ("new", "µ.yaml"), ("fit", "--help"), ("runs", "--study", "µ"),
)  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("verb", VERBS, ids=" ".join)
def test_every_verb_prints_on_a_terminal_of_ascii(place, tmp_path, monkeypatch, one_format, verb):
    folder, path = place
    monkeypatch.chdir(tmp_path)
    names = {"STUDY": str(path), "OTHER": str(folder / "other"), "KEY": sorted((folder / "lab/runs").iterdir())[0].name}
    words = [names.get(word, word) for word in verb]
    if verb[0] in ("plan", "fit", "report", "run", "export", "slurm") and "STUDY" in verb:
        words += ["--backend", "toy"]
    if verb[0] not in ("cite", "stress", "verify", "--help", "new") and "--help" not in verb:
        words += ["--lab", str(folder / "lab")]
    if verb[0] == "report":
        words += ["--out", str(tmp_path / "report")]
    whole, ended = (CliRunner(charset=charset).invoke(APP, words) for charset in ("utf-8", "ascii"))
    assert not isinstance(ended.exception, UnicodeError)
    assert ended.exit_code == whole.exit_code or verb[0] == "new"
    said = ended.stdout_bytes.decode("ascii") + ended.stderr_bytes.decode("ascii")
    assert said.strip()
    if "µ" not in "".join(verb) and "\udcff" not in "".join(verb):
        assert said.count("?") == whole.output.count("?"), "each sign has one in its place"


@pytest.mark.parametrize("encoding", ["latin-1", "cp1252", "ascii", "utf-8"])
def test_a_table_has_its_columns_also_where_signs_are_longer(place, encoding):
    folder, path = place
    ended = CliRunner(charset=encoding).invoke(
        APP, ["fit", str(path), "--backend", "toy", "--lab", str(folder / "lab")]
    )
    assert ended.exit_code == 0
    said = ended.stdout_bytes.decode(encoding)
    signs = {"latin-1": "±", "cp1252": "±", "ascii": "+-", "utf-8": "±"}
    assert f" {signs[encoding]} " in said
    rules = {line.strip() for line in said.splitlines() if line.startswith("+-")}
    assert len({len(line) for line in said.splitlines() if line[:1] in ("|", "+") and len(rules) == 1}) <= 1


def test_in_a_pipe_every_run_is_a_whole_line(tmp_path):
    path = study_file(tmp_path, count=60, orifices="[18, 21, 24, 30]", replicates=2)
    path.write_text(
        path.read_text().replace("toy-study", "a-study-whose-name-is-as-long-as-that-of-a-real-one-" + 20 * "x")
    )
    carry_out(load(path), tmp_path / "lab")
    lines = labbook("runs", "--lab", tmp_path / "lab").stdout.splitlines()
    keys = [folder.name for folder in (tmp_path / "lab/runs").iterdir()]
    rows = [line for line in lines if line.split()[:1] and any(key.startswith(line.split()[0]) for key in keys)]
    assert len(rows) == len(keys) == 8
    assert all(20 * "x" in row and "orifice" in row and "finished" in row for row in rows)
    assert "…" not in "".join(lines)
    narrow = labbook("runs", "--lab", tmp_path / "lab", COLUMNS="80").stdout.splitlines()
    assert max(map(len, narrow)) <= 80, "whoever says how wide it is gets that"


@pytest.mark.slow
def test_a_lab_whose_path_is_no_text_is_worked_in(tmp_path):
    lab = tmp_path / os.fsdecode(b"not \xff text") / "lab"
    path = study_file(tmp_path, count=400, orifices="[24]", replicates=1)
    for words in (("run", path), ("plan", path), ("fit", path), ("export", path, "--out", tmp_path / "out")):
        ended = labbook(*words, "--lab", lab, "--backend", "toy", check=False)
        assert ended.exit_code == (1 if words[0] == "export" and "Error" in ended.output else 0), ended.output
    for words in (("status",), ("runs",), ("reindex",), ("show", next((lab / "runs").iterdir()).name)):
        assert labbook(*words, "--lab", lab).output
    next((lab / "runs").iterdir()).joinpath("run.json").write_text("{}")
    assert "cannot be read" in labbook("status", "--lab", lab).output
    assert "Unreadable" in labbook("reindex", "--lab", lab).output
