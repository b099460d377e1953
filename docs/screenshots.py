"""Pictures of the web app for docs/web.md, taken by Chromium.

    python docs/screenshots.py --lab lab

Runs the studies that are shown if the lab does not have them (some ten minutes on two cores), serves the lab, and
writes docs/web/*.png: every page light, dark and as a phone shows it. Needs Debian's chromium, and playwright.
"""

import argparse
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path

from PIL import Image
from playwright.sync_api import Page, ViewportSize, expect, sync_playwright

from labbook.lab import Catalogue
from labbook.lab.catalogue import Listing

HERE = Path(__file__).parent
SHOWN = ("hopper-angle", "conical-silo", "quickstart", "binary-mixture", "pongo2022-small")
CHROMIUM = "/usr/bin/chromium"
ARGUMENTS = (
    "--no-sandbox", "--enable-unsafe-swiftshader", "--disable-quic", "--no-first-run",
    "--disable-background-networking", "--disable-component-update", "--disable-sync",
)  # fmt: skip
DESKTOP, PHONE = ViewportSize(width=1280, height=860), ViewportSize(width=390, height=844)
LARGEST = 300_000  # bytes of a picture
_VIEWER = 25_000  # ms until the viewer has drawn by a software rasteriser
_COLOURS = 256
_SCROLL = "element => window.scrollTo(0, element.getBoundingClientRect().top + scrollY - 80)"


def main() -> None:
    """Take all pictures."""
    words = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    words.add_argument("--lab", type=Path, default=Path("lab"))
    words.add_argument("--out", type=Path, default=HERE / "web")
    said = words.parse_args()
    for name in SHOWN:
        command = [sys.executable, "-c", "from labbook.cli import main; main()"]
        study = str(HERE.parent / "studies" / f"{name}.yaml")
        for verb in ("run", "fit"):
            subprocess.run([*command, verb, study, "--lab", str(said.lab)], check=True, stdout=subprocess.DEVNULL)
    said.out.mkdir(exist_ok=True)
    runs, _ = Catalogue(said.lab).listed(
        Listing(study="pongo2022-small", outcome="finished", sort="seed", descending=False)
    )
    rods = f"/run/{runs.run_key[0][:16]}"
    points = "item=point:hopper-angle:3&item=point:hopper-angle:18"
    pages = {
        "lab": "/",
        "study": "/study/hopper-angle",
        "explore": "/study/hopper-angle/explore?at=45,25&want=40&over=container.orifice",
        "point": "/study/hopper-angle/point/3",
        "run": rods,
        "runs": "/runs",
        "compare": f"/compare?{points}",
    }
    with served(said.lab) as address, sync_playwright() as play:
        browser = play.chromium.launch(executable_path=CHROMIUM, args=ARGUMENTS)
        for name, path in pages.items():
            for look, size in (("", DESKTOP), ("-dark", DESKTOP), ("-phone", PHONE)):
                context = browser.new_context(color_scheme="dark" if look == "-dark" else "light", viewport=size)
                page = context.new_page()
                page.goto(address + path)
                page.wait_for_load_state("networkidle")
                page.wait_for_timeout(1500)
                photograph(page, said.out / f"{name}{look}.png")
                if name == "study" and not look:
                    scrolled(page, "#beds-title", said.out / "study-beds.png")
                    brushed(page, said.out / "study-ranges.png")
                if name == "run" and not look:
                    page.get_by_role("button", name="Open in the viewer").click()
                    expect(page.locator("iframe")).to_be_visible(timeout=60_000)
                    page.wait_for_timeout(_VIEWER)
                    photograph(page, said.out / "run-viewer.png")
                context.close()
        browser.close()


def scrolled(page: Page, to: str, path: Path) -> None:
    """The page from an element on."""
    page.locator(to).evaluate(_SCROLL)
    page.wait_for_load_state("networkidle")
    page.wait_for_timeout(1000)
    photograph(page, path)


def brushed(page: Page, path: Path) -> None:
    """The parallel coordinates with a range on the second axis."""
    page.locator("#parallel").evaluate("element => { element.closest('details').open = true; }")
    page.locator("#all-points").evaluate(_SCROLL)
    box = page.locator("#parallel .grip").nth(2).bounding_box()
    assert box is not None
    x = box["x"] + box["width"] / 2
    page.mouse.move(x, box["y"] + 0.1 * box["height"])
    page.mouse.down()
    page.mouse.move(x, box["y"] + 0.45 * box["height"], steps=8)
    page.mouse.up()
    page.wait_for_timeout(500)
    page.locator("#all-points").evaluate(_SCROLL)  # the table above has fewer rows now
    photograph(page, path)


def photograph(page: Page, path: Path) -> None:
    """What the window shows, as a small PNG."""
    image = Image.open(BytesIO(page.screenshot())).convert("RGB")
    image.quantize(_COLOURS, dither=Image.Dither.NONE).save(path, optimize=True)
    size = path.stat().st_size
    print(f"{path} {size // 1000} kB")
    if size > LARGEST:
        raise SystemExit(f"{path} has {size} bytes, more than {LARGEST}")


@contextmanager
def served(lab: Path) -> Iterator[str]:
    """The address of `labbook web` on a lab."""
    command = [sys.executable, "-c", "from labbook.cli import main; main()", "web", "--lab", str(lab), "--no-open"]
    process = subprocess.Popen([*command, "--port", "0", "--read-only"], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    try:
        line = process.stdout.readline()
        yield next(word for word in line.split() if word.startswith("http://")).rstrip("/")
    finally:
        process.terminate()
        process.wait(30)


if __name__ == "__main__":
    main()
