"""Files that are no studies: not there, not YAML, or made to exhaust the reader."""

import pytest
from wrong_study import problems

from labbook.study import StudyError, load


@pytest.mark.parametrize(
    ("raw", "message"),
    [
        (b"", "empty"),
        (b"- a\n- b\n", "a mapping of keys"),
        (b"just words", "a mapping of keys"),
        (b"name: \xff\xfe", "UTF-8"),
        (b"name: [", "not valid YAML"),
        (b"name: 'x", "not valid YAML"),
        (b"name: *nothing", "not valid YAML"),
        (b"a: 1\n---\nb: 1\n", "not valid YAML"),
        (b"name: !!python/object:os.system x", "the tag"),
        (b"? [a, b]\n: 1\n", "a key is a word"),
        (b"a: &a [*a]", "nested too deeply"),
        (b"a: " + b"[" * 1000, "nested too deeply"),
        (b"a: " + b"[" * 100 + b"]" * 100, "nested too deeply"),
        (b"x" * 2_000_001, "larger than 2 MB"),
    ],
)
def test_files_that_are_no_studies(tmp_path, raw, message):
    file = tmp_path / "study.yaml"
    file.write_bytes(raw)
    with pytest.raises(StudyError) as caught:
        load(file)
    assert message in caught.value.problems[0].message
    assert caught.value.problems[0].remedy


def test_alias_bombs_do_not_explode(tmp_path):
    bomb = "a0: &a0 [x, x, x, x, x, x, x, x, x]\n"
    bomb += "".join(f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 9)}]\n" for n in range(1, 9))
    (problem,) = problems(tmp_path, bomb)
    assert "too many values" in problem.message


@pytest.mark.parametrize("name", ["nothing.yaml", ".", "nothing.yaml/below", "null\0"])
def test_files_that_are_not_there(tmp_path, name):
    with pytest.raises(StudyError, match="cannot be read"):
        load(tmp_path / name)
