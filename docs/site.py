"""Hooks of mkdocs: pages and files that stand outside docs/, and the tutorial, as pages of the site.

A link of a page to a file of the repository, such as ../studies/quickstart.yaml, becomes a link to a copy within the
site. So the site needs no network, and a strict build finds every link that leads nowhere.
"""

import html
import json
import posixpath
import re
from pathlib import Path

from mkdocs.structure.files import File, Files

import labbook

ROOT = Path(__file__).parents[1]
PAGES = {
    "ARCHITECTURE.md": "architecture.md",
    "CONTRIBUTING.md": "contributing.md",
    "CHANGELOG.md": "changelog.md",
    "docs/tutorial.ipynb": "tutorial.md",
}
"""Pages that are made of files of the repository."""
ELSEWHERE = {"README.md": "index.md", "studies": "gallery.md"}
"""Where links to other things of the repository lead."""
COPIES = "files"
"""Folder of the site for other files of the repository that pages link to."""
_LINK = re.compile(r"(!?\[[^\]]*\])\(([^)#\s]+)(#[^)\s]*)?\)")


def on_files(files: Files, config) -> Files:
    """Add the pages of PAGES, and copies of what pages link to."""
    for source, page in PAGES.items():
        text = _notebook(ROOT / source) if source.endswith(".ipynb") else (ROOT / source).read_text(encoding="utf-8")
        files.append(File.generated(config, page, content=text))
    files.append(File.generated(config, "gallery.md", content=_gallery()))
    linked = {name for file in files if file.src_uri.endswith(".md") for name in _outside(file)}
    for name in sorted(linked):
        files.append(File.generated(config, f"{COPIES}/{name}", abs_src_path=str(ROOT / name)))
    return files


def on_page_markdown(markdown: str, page, config, files: Files) -> str:
    """Let links lead to where things are in the site."""
    home = posixpath.dirname(page.file.src_uri)

    def there(found: re.Match) -> str:
        label, target, anchor = found[1], found[2], found[3] or ""
        place = _place(page.file.src_uri, target)
        return found[0] if place is None else f"{label}({posixpath.relpath(place, home or '.')}{anchor})"

    return _LINK.sub(there, markdown)


def _source(uri: str) -> str:
    """The path in the repository from which relative links of a page start."""
    return next((source for source, page in PAGES.items() if page == uri), f"docs/{uri}")


def _target(uri: str, target: str) -> str | None:
    """The path in the repository of what a page links to; None for addresses of the web."""
    if re.match(r"[a-z]+:", target):
        return None
    return posixpath.normpath(posixpath.join(posixpath.dirname(_source(uri)), target))


def _place(uri: str, target: str) -> str | None:
    """Where a link of a page leads in the site; None if it stays as it is."""
    name = _target(uri, target)
    if name is None:
        return None
    if name in PAGES:
        return PAGES[name]
    if name in ELSEWHERE:
        return ELSEWHERE[name]
    if name.startswith("docs/"):
        return name.removeprefix("docs/")
    return f"{COPIES}/{_file(name)}"


def _file(name: str) -> str:
    """`name`, or the file that tells of a folder."""
    if not (ROOT / name).is_dir():
        return name
    return next(
        (f"{name}/{one}" for one in ("README.md", "pyproject.toml", "__init__.py") if (ROOT / name / one).exists()),
        name,
    )


def _outside(file: File) -> list[str]:
    places = (_place(file.src_uri, found[2]) for found in _LINK.finditer(file.content_string))
    names = [place.removeprefix(f"{COPIES}/") for place in places if place and place.startswith(f"{COPIES}/")]
    return [name for name in names if (ROOT / name).is_file()]


def _gallery() -> str:
    """Every study that ships, with the container and grains of its first point, drawn from the study itself."""
    head = "Every study that ships. Pictures are sections through the container of the first point."
    parts = ["# Gallery", head]
    for path in sorted((ROOT / "studies").glob("*.yaml")):
        study = labbook.load(path)
        swept = ", ".join(f"`{key}`" for key in study.units) or "nothing"
        points, runs = len(study.points), len(study.points) * study.replicates
        parts += [
            f"## {study.name}",
            f"{study.about}. Sweeps {swept}: {points} points, {runs} runs. [Study file](../studies/{path.name})",
            f'<div class="scene">{study.points[0].scene.svg()}</div>',
        ]
    return "\n\n".join(parts) + "\n"


def _notebook(path: Path) -> str:
    """A notebook with its outputs, as Markdown."""
    parts: list[str] = []
    for cell in json.loads(path.read_text(encoding="utf-8"))["cells"]:
        text = "".join(cell["source"])
        if cell["cell_type"] == "markdown":
            parts.append(text)
            continue
        parts.append(f"```python\n{text}\n```")
        for output in cell.get("outputs", ()):
            data = output.get("data", {})
            if "image/png" in data:
                parts.append(f'<img alt="" src="data:image/png;base64,{"".join(data["image/png"]).strip()}">')
            elif "image/svg+xml" in data:
                parts.append(f"<div>{''.join(data['image/svg+xml'])}</div>")
            elif "text/html" in data:
                parts.append("<div>" + re.sub(r"\n\s*\n", "\n", "".join(data["text/html"])) + "</div>")
            elif shown := "".join(data.get("text/plain", output.get("text", ""))):
                parts.append(f"<pre>{html.escape(shown)}</pre>")
    return "\n\n".join(parts) + "\n"
