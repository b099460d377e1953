"""Editors, notebooks and `help` know the keys of a study, their choices, laws and figures."""

import inspect
import json
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, get_args

import pytest

from labbook.fit import LAWS
from labbook.report import gallery
from labbook.study import Study, define, page, stated, static
from labbook.study.schema import TOP_KEYS

ROOT = Path(__file__).parents[3]


def test_types_are_those_of_the_models():
    written = Path(stated.__file__).read_text(encoding="utf-8")
    assert static.module_text() == written, "run: make docs"


@pytest.mark.parametrize("function", [define, Study.change])
def test_help_lists_every_key_with_its_unit(function):
    shown = " ".join((inspect.getdoc(function) or "").split())
    for key in page.documented_keys():
        section, _, leaf = key.name.rpartition(".")
        listed = shown.partition(f"{section}: " if section else "docs/studies.md): ")[2]
        word = f"{leaf} [{key.unit}]" if key.unit else leaf
        assert re.match(rf"(?:[\w /^]|, |\[[^\]]*\])*?(?<!\w){re.escape(word)}(?!\w)", listed), key.name


@pytest.mark.parametrize("function", [define, Study.change])
def test_a_signature_names_the_keys_as_notebooks_complete_them(function):
    parameters = inspect.signature(function).parameters.values()
    assert [one.name for one in parameters if one.kind is one.KEYWORD_ONLY] == list(TOP_KEYS)


def test_names_of_laws_and_figures_are_those_that_there_are():
    assert get_args(stated.LawName) == tuple(LAWS)
    drawn = re.findall(r'drawings\["(\w+)"\] =', inspect.getsource(gallery))
    assert sorted(get_args(gallery.FigureName)) == sorted({*drawn, *gallery.FILES})


class Editor:
    """The language server of pyright, as an editor talks to it."""

    def __init__(self, command: str, folder: Path):
        self._folder, self._number = folder, 0
        self._process = subprocess.Popen([command, "--stdio"], stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        capabilities = {"workspace": {"configuration": True}}
        there = {"uri": folder.as_uri(), "name": folder.name}
        started = {"processId": None, "rootUri": folder.as_uri(), "workspaceFolders": [there]}
        self._ask("initialize", {**started, "capabilities": capabilities})
        self._send({"method": "initialized", "params": {}})

    def close(self) -> None:
        self._process.kill()
        self._process.communicate()

    def completed(self, text: str) -> list[str]:
        """The words that are offered at the `|` of a module."""
        before, _, after = text.partition("|")
        document: dict[str, Any] = {"uri": (self._folder / f"module{self._number}.py").as_uri()}
        opened = {**document, "languageId": "python", "version": 1, "text": before + after}
        self._send({"method": "textDocument/didOpen", "params": {"textDocument": opened}})
        place = {"line": before.count("\n"), "character": len(before.rpartition("\n")[2])}
        answer = self._ask("textDocument/completion", {"textDocument": document, "position": place})
        return [item["label"].strip('"') for item in (answer or {}).get("items", ())]

    def _ask(self, method: str, params: dict[str, Any]) -> Any:
        self._number += 1
        self._send({"id": self._number, "method": method, "params": params})
        for message in self._messages():
            if "method" not in message and message.get("id") == self._number:
                return message.get("result")
            if "method" in message and "id" in message:  # it asks for settings
                asked = message.get("params", {}).get("items", ())
                self._send({"id": message["id"], "result": [{} for _ in asked]})

    def _send(self, message: dict[str, Any]) -> None:
        body = json.dumps({"jsonrpc": "2.0", **message}).encode()
        assert self._process.stdin is not None
        self._process.stdin.write(b"Content-Length: %d\r\n\r\n" % len(body) + body)
        self._process.stdin.flush()

    def _messages(self) -> Iterator[dict[str, Any]]:
        assert self._process.stdout is not None
        while True:
            length = 0
            while line := self._process.stdout.readline().strip():
                if line.lower().startswith(b"content-length:"):
                    length = int(line.partition(b":")[2])
            yield json.loads(self._process.stdout.read(length))


@pytest.mark.ring  # the types that the server reads are tested above
def test_an_editor_completes_keys_choices_laws_and_figures(tmp_path):
    server = shutil.which("pyright-langserver", path=str(Path(sys.executable).parent))
    if server is None:
        pytest.skip("no pyright")
    environment = Path(sys.prefix)
    settings = {"extraPaths": [str(ROOT)], "venvPath": str(environment.parent), "venv": environment.name}
    (tmp_path / "pyrightconfig.json").write_text(json.dumps(settings))
    editor = Editor(server, tmp_path)
    study, results = "import labbook\nlabbook.define(name='a', ", "import labbook\ndef f(r: labbook.Results):\n    r."
    try:
        assert "grains=" in editor.completed(study + "gra|)\n")
        assert "diameter" in editor.completed(study + 'grains={"|"})\n')
        assert "hertz-mindlin" in editor.completed(study + 'contact={"law": "|"})\n')
        assert "container.orifice" in editor.completed(study + 'sweep={"container.|"})\n')
        change = "import labbook\ndef f(s: labbook.Study):\n    s.change("
        assert "sweep.container.orifice" in editor.completed(change + '{"container.|"})\n')
        assert "replicates=" in editor.completed(change + "repl|)\n")
        assert "beverloo" in editor.completed(results + 'fit("|")\n')
        assert "flow_over_time" in editor.completed(results + 'plot("|")\n')
    finally:
        editor.close()
