"""A picture of a part of a report: photograph.py REPORT.html SELECTOR PICTURE.png. Needs Chromium."""

from __future__ import annotations

import base64
import shutil
import sys
import tempfile
from pathlib import Path

from selenium import webdriver

WIDTH, HEIGHT = 1000, 1076  # [pixels]
INSTANT = 0.6  # [s] after the strike: the bicycle leans and turns
FLAGS = "headless no-sandbox disable-gpu disable-quic no-first-run disable-background-networking disable-sync"


def main(report: str, selector: str, picture: str) -> None:
    """Open the report, set the time, take the picture."""
    options = webdriver.ChromeOptions()
    options.binary_location = shutil.which("chromium") or ""
    with tempfile.TemporaryDirectory() as profile:
        for flag in (*FLAGS.split(), "disable-component-update", f"user-data-dir={profile}"):
            options.add_argument(f"--{flag}")
        service = webdriver.ChromeService(executable_path=shutil.which("chromedriver"))
        browser = webdriver.Chrome(options=options, service=service)
        try:
            Path(picture).write_bytes(_photograph(browser, Path(report).resolve().as_uri(), selector))
        finally:
            browser.quit()


def _photograph(browser: webdriver.Chrome, address: str, selector: str) -> bytes:
    metrics = {"width": WIDTH, "height": HEIGHT, "deviceScaleFactor": 1, "mobile": False}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", metrics)
    browser.get(address)
    browser.execute_script("dispatchEvent(new Event('beforeprint'))")
    browser.execute_script(
        "const slider = document.querySelector(arguments[0] + ' input.time'); slider.value = arguments[1];"
        "slider.dispatchEvent(new Event('input'))",
        selector,
        INSTANT,
    )
    top = browser.execute_script(
        "return document.querySelector(arguments[0]).getBoundingClientRect().top + scrollY", selector
    )
    clip = {"x": 0, "y": top, "width": WIDTH, "height": HEIGHT, "scale": 1}
    taken = browser.execute_cdp_cmd("Page.captureScreenshot", {"captureBeyondViewport": True, "clip": clip})
    return base64.b64decode(taken["data"])


if __name__ == "__main__":
    main(*sys.argv[1:])
