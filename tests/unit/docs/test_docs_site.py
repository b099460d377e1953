"""The documentation builds as a site: strictly, without a network, with every page in its navigation."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

import labbook
from labbook.study import load

ROOT = Path(__file__).parents[3]

pytest.importorskip("material", reason="mkdocs-material is not installed")


@pytest.fixture(scope="module")
def site(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("site")
    built = build(ROOT / "mkdocs.yml", folder)
    assert built.returncode == 0, built.stdout + built.stderr
    return folder


def build(configuration: Path, folder: Path) -> subprocess.CompletedProcess[str]:
    """Build the site as `make docs` does, into `folder`."""
    command = [sys.executable, "-m", "mkdocs", "build", "--config-file", str(configuration), "--site-dir", str(folder)]
    environment = {**os.environ, "NO_MKDOCS_2_WARNING": "1", "PYTHONPATH": str(ROOT)}
    return subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)


def test_every_page_is_there(site):
    pages = {path.relative_to(ROOT / "docs").with_suffix("") for path in (ROOT / "docs").rglob("*.md")}
    made = {path.relative_to(site).with_suffix("") for path in site.rglob("*.html")}
    assert {page.with_name("index") if page.name == "README" else page for page in pages} <= made


def test_the_gallery_shows_every_study(site):
    gallery = (site / "gallery.html").read_text(encoding="utf-8")
    for path in (ROOT / "studies").glob("*.yaml"):
        assert re.search(f'<h3 id="{re.escape(path.stem)}">', gallery), path.name
        assert (site / "files/studies" / path.name).exists()
    assert gallery.count('<div class="scene') == len(list((ROOT / "studies").glob("*.yaml")))


def test_beds_of_the_gallery_move_but_not_for_who_asks_for_less_motion(site):
    gallery = (site / "gallery.html").read_text(encoding="utf-8")
    loops = sorted((ROOT / "docs/loops").glob("*.webp"))
    assert loops
    for path in loops:
        assert path.stat().st_size <= 80_000, path.name
        card = gallery.split(f'<h3 id="{path.stem}">')[1].split("<h3")[0]
        (source,) = re.findall(r'<div class="loop"><img [^>]*src="([^"]*)"', card)
        assert (site / source).read_bytes() == path.read_bytes()
        assert '<div class="scene still"><svg' in card
    rules = re.findall(r"@media \(prefers-reduced-motion: reduce\) \{(.*)\}", (site / "site.css").read_text("utf-8"))
    assert ".card .loop { display: none; }" in rules[0]
    assert ".card .scene.still { display: block; }" in rules[0]


def test_cards_have_the_figure_and_the_claim_of_their_page_and_papers_come_first(site):
    gallery = (site / "gallery.html").read_text(encoding="utf-8")
    parts = re.findall(r'<h2 id="[^"]*">([^<]*)<', gallery)
    assert parts == ["Fan et al. 2023", "Pongó et al. 2022", "Dosta et al. 2024", "Silos", "Calibration"]
    card = gallery.split('<h3 id="clogging-layer">')[1].split("<h3")[0]
    assert 'src="results/clogging-layer.png"' in card
    assert "falls by a factor of 27" in card
    assert 'href="results/clogging-layer.html"' in card
    results = (site / "results/index.html").read_text(encoding="utf-8")
    pages = [path for path in (ROOT / "docs/results").glob("*.md") if path.name != "README.md"]
    assert results.count('<div class="card">') == len(pages), "each page of results begins with a claim"
    assert results.index("fan2023-flat-column.png") < results.index("clogging-layer.png")


def test_the_tutorial_shows_its_outputs(site):
    tutorial = (site / "tutorial.html").read_text(encoding="utf-8")
    assert "data:image/png;base64," in tutorial
    assert "flow_rate" in tutorial


def test_nothing_is_loaded_from_elsewhere(site):
    for page in site.rglob("*.html"):
        loaded = re.findall(
            r'<(?:script|img|link)[^>]*(?:src|href)="(https?://[^"]+)"', page.read_text(encoding="utf-8")
        )
        assert not [address for address in loaded if "canonical" not in address], page.name


def test_no_asterisk_of_a_symbol_is_taken_for_emphasis(site):
    """E*, s*, D/d*: two in a line without a blank make what is between them slanted, and are lost."""
    for page in site.rglob("*.html"):
        assert not re.findall(r"\w<em>[^<]*", page.read_text(encoding="utf-8")), page.name


def test_a_link_that_leads_nowhere_fails_the_build(tmp_path):
    (tmp_path / "docs").mkdir()
    (tmp_path / "docs/index.md").write_text("# Start\n\n[nowhere](no-such-page.md)\n")
    text = (ROOT / "mkdocs.yml").read_text(encoding="utf-8")
    text = re.sub(r"nav:\n(?: .*\n)+", "", re.sub(r"hooks:\n(?: .*\n)+|extra_css:\n(?: .*\n)+", "", text))
    (tmp_path / "mkdocs.yml").write_text(text)
    built = build(tmp_path / "mkdocs.yml", tmp_path / "site")
    assert built.returncode != 0
    assert "no-such-page.md" in built.stderr


@pytest.mark.parametrize(("page", "points"), [("README.md", 4), ("docs/start.md", 6)])
def test_the_study_of_a_page_is_one(page, points, tmp_path):
    block = re.findall(r"```yaml\n(.*?)```", (ROOT / page).read_text(encoding="utf-8"), re.DOTALL)[0]
    named = block if "name:" in block else f"name: of-a-page\n{block}"
    (tmp_path / "study.yaml").write_text(named, encoding="utf-8")
    study = load(tmp_path / "study.yaml")
    assert isinstance(study, labbook.Study)
    assert len(study.points) == points


def test_pages_opened_from_a_folder_can_be_searched(site):
    index = (site / "search/search_index.js").read_text(encoding="utf-8")
    assert index.startswith("var __index = {")
    assert "Janda" in index
    for page in site.rglob("*.html"):
        worker = re.search(r'<script src="([^"]*iframe-worker-shim.js)"', page.read_text(encoding="utf-8"))
        assert worker is not None, page.name
        assert page.name == "404.html" or (page.parent / worker[1]).exists(), page.name
