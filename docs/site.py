"""Hooks of mkdocs: pages and files that stand outside docs/, and the tutorial, as pages of the site.

A link of a page to a file of the repository, such as ../studies/quickstart.yaml, becomes a link to a copy within the
site. So the site needs no network, and a strict build finds every link that leads nowhere.
"""

import html
import json
import posixpath
import re
from collections.abc import Sequence
from dataclasses import dataclass
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
GROUPS = {
    "fan2023-": "Fan et al. 2023",
    "pongo2022-": "Pongó et al. 2022",
    "dosta2024": "Dosta et al. 2024",
    "accuracy-": "Calibration",
    "": "Silos",
}
"""Parts of the gallery by how names of their studies begin."""
PAPERS_FIRST = ("Fan et al. 2023", "Pongó et al. 2022", "Dosta et al. 2024", "Silos")
CARDS = "<!-- cards of all results -->"
"""Where the page of results has its cards."""
LOOPS = "loops"
"""Folder of beds in motion, by study (docs/loops.py)."""
COPIES = "files"
"""Folder of the site for other files of the repository that pages link to."""
_LINK = re.compile(r"(!?\[[^\]]*\])\(([^)#\s]+)(#[^)\s]*)?\)")


def on_files(files: Files, config) -> Files:
    """Add the pages of PAGES, and copies of what pages link to."""
    for source, page in PAGES.items():
        text = _notebook(ROOT / source) if source.endswith(".ipynb") else (ROOT / source).read_text(encoding="utf-8")
        files.append(File.generated(config, page, content=text))
    files.append(File.generated(config, "gallery.md", content=_gallery()))
    files.append(File.generated(config, "logo.svg", abs_src_path=str(ROOT / "web/labbook_web/static/icon.svg")))
    linked = {name for file in files if file.src_uri.endswith(".md") for name in _outside(file)}
    for name in sorted(linked):
        files.append(File.generated(config, f"{COPIES}/{name}", abs_src_path=str(ROOT / name)))
    return files


def on_page_markdown(markdown: str, page, config, files: Files) -> str:
    """Let links lead to where things are in the site."""
    home = posixpath.dirname(page.file.src_uri)
    if CARDS in markdown:
        markdown = markdown.replace(CARDS, _cards_of_results())

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
    """Every study that ships, papers first, as cards: container and grains of its first point, and its result."""
    parts = [
        "# Gallery",
        "Every study that ships. Beds in motion show the first point with few grains, in a smaller container. "
        "Other pictures are sections through its container; where the system asks for less motion, all are.",
    ]
    results = _results()
    for title, stems in _groups(sorted(path.stem for path in (ROOT / "studies").glob("*.yaml"))).items():
        parts += [f"## {title}", '<div class="cards" markdown>']
        of = {stem: _of_study(stem, results) for stem in stems}
        for stem, result in sorted(of.items(), key=lambda item: (item[1] is None, item[0])):
            study = labbook.load(ROOT / "studies" / f"{stem}.yaml")
            swept = ", ".join(f"`{key}`" for key in study.units) or "nothing"
            points, runs = len(study.points), len(study.points) * study.replicates
            parts += [
                '<div class="card" markdown>',
                f"### {study.name}",
                *_scene(study),
                f"{study.about}. Sweeps {swept}: {points} points, {runs} runs. [Study file](../studies/{stem}.yaml)",
                *(result.shown("results/") if result is not None else []),
                "</div>",
            ]
        parts.append("</div>")
    return "\n\n".join(parts) + "\n"


def _scene(study: labbook.Study) -> list[str]:
    """The bed of the first point: in motion where there is a loop, and a drawing for who asks for less motion."""
    drawing = f'<div class="scene">{study.points[0].scene.svg()}</div>'
    if not (ROOT / "docs" / LOOPS / f"{study.name}.webp").is_file():
        return [drawing]
    loop = f'<img loading="lazy" alt="The bed in motion" src="{LOOPS}/{study.name}.webp">'
    return [f'<div class="loop">{loop}</div>', drawing.replace('class="scene"', 'class="scene still"')]


def _groups(stems: Sequence[str]) -> dict[str, list[str]]:
    """Names of studies by the title of their part of the gallery."""
    groups: dict[str, list[str]] = {title: [] for title in GROUPS.values()}
    for stem in stems:
        groups[next(title for prefix, title in GROUPS.items() if stem.startswith(prefix))].append(stem)
    return {title: groups[title] for title in dict.fromkeys((*PAPERS_FIRST, *groups))}


@dataclass(frozen=True)
class Result:
    """A page of results: its title, its claim (its first bold words), its first figure, and the studies it names."""

    page: str
    title: str
    claim: str
    figure: str
    studies: tuple[str, ...]

    def shown(self, folder: str) -> list[str]:
        """Figure and claim with a link to the page, as Markdown; `folder`: of results, as the card's page sees it."""
        figure = self.figure.replace("](", f"]({folder}")
        return [*([figure] if figure else []), f"{self.claim} [Result]({folder}{self.page})"]


def _results() -> list[Result]:
    """All pages of results that begin with a claim."""
    results = []
    for path in sorted((ROOT / "docs" / "results").glob("*.md")):
        text = path.read_text(encoding="utf-8")
        claim = re.search(r"^\*\*(.+?)\*\*", text, re.DOTALL | re.MULTILINE)
        if path.name != "README.md" and claim is not None:
            figure, title = re.search(r"!\[[^\]]*\]\([^)]+\)", text), text.partition("\n")[0].lstrip("# ")
            words = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", " ".join(claim[1].split()))  # links lead from there only
            studies = dict.fromkeys(re.findall(r"studies/([\w-]+)\.yaml", text))
            results.append(Result(path.name, title, words, figure[0] if figure else "", tuple(studies)))
    return results


def _of_study(stem: str, results: Sequence[Result]) -> Result | None:
    """The page of results that a study has: of its name, or else the first that names it."""
    naming = [result for result in results if stem in result.studies]
    return next((result for result in naming if result.page == f"{stem}.md"), next(iter(naming), None))


def _cards_of_results() -> str:
    """All pages of results as cards, papers first."""
    pages = {result.page.removesuffix(".md"): result for result in _results()}
    parts = ['<div class="cards" markdown>']
    for result in (pages[page] for group in _groups(list(pages)).values() for page in group):
        parts += ['<div class="card" markdown>', f"**{result.title}**", *result.shown(""), "</div>"]
    return "\n\n".join([*parts, "</div>"])


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
