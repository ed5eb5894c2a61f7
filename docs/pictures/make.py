"""Draw the pictures that the README shows, from a run of the demo: ``make pictures``."""

import signal
import subprocess
import sys
import tempfile
from pathlib import Path

from playwright.sync_api import sync_playwright

from spiral.cli import main
from spiral.io.curves import read_curves
from spiral.io.storage import load_run
from spiral.view.report.html import figures, single_figure_page
from spiral.view.report.pictures import find_browser, write_png

SHOWN = ("error_falling", "where", "surface")


def draw(target: Path) -> None:
    with tempfile.TemporaryDirectory() as out:
        study = ("discover", "experiment=rotor_coastdown", "tracking.enabled=false", f"out={out}")
        if main([*study]) != 0:
            raise SystemExit("the demo failed")
        saved = load_run("latest", out)
        for shown in figures(saved.data, read_curves(saved.file.parent)):
            if shown.name in SHOWN:
                height = int(shown.figure.layout.height) + 4
                print(
                    write_png(single_figure_page(shown), target / f"{shown.name}.png", 1060, height)
                )


def photograph(target: Path) -> None:
    """The page after two clicks on Add, as a person sees it."""
    with tempfile.TemporaryDirectory() as out, sync_playwright() as p:
        command = [sys.executable, "-m", "spiral", "app", "--port", "0", "--no-browser"]
        program = subprocess.Popen([*command, f"out={out}"], stdout=subprocess.PIPE, text=True)
        assert program.stdout is not None
        window = p.chromium.launch(executable_path=find_browser(), args=["--no-sandbox"])
        page = window.new_page(viewport={"width": 1280, "height": 940})
        page.set_default_timeout(90_000)
        page.goto(program.stdout.readline().split()[2])
        page.click(".choice:has-text('Rotor coastdown')")
        for effect in ("cross stiffness", "cubic stiffness"):
            page.click(f"button[aria-label='Add {effect}']:enabled")
        page.wait_for_selector("button[aria-label='Add gyroscopic']:enabled")
        page.wait_for_selector("a:has-text('MLflow')")
        page.wait_for_timeout(1500)
        page.mouse.move(0, 0)
        page.screenshot(path=target / "app.png")
        print(target / "app.png")
        window.close()
        program.send_signal(signal.SIGINT)
        program.wait(15)


if __name__ == "__main__":
    draw(Path(__file__).parent)
    photograph(Path(__file__).parent)
