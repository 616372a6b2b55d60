"""The report in headless Chromium, as its reader opens, uses and prints it."""

from __future__ import annotations

import base64
import json
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from tms_bag import BagWriter

webdriver = pytest.importorskip(
    "selenium.webdriver", reason="selenium, which drives the browser, isn't there"
)
Keys = pytest.importorskip("selenium.webdriver.common.keys").Keys
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
DRIVER = shutil.which("chromedriver")
pytestmark = pytest.mark.skipif(
    not (CHROMIUM and DRIVER),
    reason="no Chromium with its chromedriver: apt-get install chromium chromium-driver",
)
FLAGS = (
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--disable-dev-shm-usage",
)


@pytest.fixture(scope="module")
def bag(make_run: Any, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("browser") / "bag"
    with BagWriter(path) as bag:
        for record in make_run("tms_strike", strike__time=1.5037, duration=5.0).records():
            bag.write(record)
    return path


@pytest.fixture(scope="module")
def report(bag: Path) -> Path:
    path = bag.parent / "report.html"
    command = [sys.executable, "-m", "tms_fit", "report", str(bag), "-o", str(path)]
    subprocess.run(command, check=True, capture_output=True)
    return path


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    options = webdriver.ChromeOptions()
    options.binary_location = str(CHROMIUM)
    for flag in (*FLAGS, f"--user-data-dir={tmp_path_factory.mktemp('profile')}"):
        options.add_argument(flag)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    service = webdriver.ChromeService(executable_path=DRIVER)
    driver = webdriver.Chrome(options=options, service=service)
    yield driver
    driver.quit()


@pytest.fixture
def page(browser: Any, report: Path) -> Any:
    return opened(browser, report)


def opened(browser: Any, report: Path, width: int = 1366) -> Any:
    """The report, with every plot drawn, as before printing."""
    size = {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": width < 600}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
    for kind in ("browser", "performance"):
        browser.get_log(kind)
    browser.get(report.as_uri())
    browser.execute_script("dispatchEvent(new Event('beforeprint'))")
    wait(browser, "return [...document.querySelectorAll('.plot')].every(one => one.querySelector('svg'))")
    return browser


def wait(browser: Any, condition: str) -> None:
    deadline = time.monotonic() + 300.0
    while not browser.execute_script(condition):
        assert time.monotonic() < deadline, condition
        time.sleep(0.05)


def test_opens_without_a_complaint_and_asks_nobody_for_anything(page: Any, report: Path) -> None:
    assert page.get_log("browser") == []
    events = [json.loads(entry["message"])["message"] for entry in page.get_log("performance")]
    asked = [e["params"]["request"]["url"] for e in events if e["method"] == "Network.requestWillBeSent"]
    assert asked == [report.as_uri()]
    assert page.execute_script("return performance.getEntriesByType('resource').length") == 0


@pytest.mark.long
def test_numbers_shown_are_those_of_fit_run(page: Any, bag: Path) -> None:
    command = [sys.executable, "-m", "tms_fit", "run", str(bag), "--json"]
    document = json.loads(subprocess.run(command, check=True, capture_output=True).stdout)
    parameters = document["strikes"][0]["estimates"][0]["parameters"]
    rows = page.execute_script(ROWS)
    assert [name.replace(" ", "_") for name, _ in rows] == list(parameters)
    for (_, cells), expected in zip(rows, parameters.values(), strict=True):
        assert [value for value, _ in cells] == [expected["value"], expected["std"], *expected["ci95"]]
        for value, text in cells:
            places = len(text.partition(".")[2])
            assert text.replace("\u2212", "-") == f"{value:.{places}f}"
            assert 10 <= round(expected["std"] * 10**places) < 100  # two digits of the standard error


ROWS = """
return [...document.querySelectorAll('table.parameters tbody tr')].map(row => [
  row.cells[0].innerText,
  [...row.querySelectorAll('data')].map(one => [Number(one.value), one.innerText]),
]);
"""


def test_policy_is_kept_by_the_browser(page: Any) -> None:
    # A script that comes in later does not run, and nothing can be fetched.
    page.execute_script(INTRUDE)
    assert page.execute_script("return window.intruder") is None
    complaints = " ".join(entry["message"] for entry in page.get_log("browser"))
    assert "Content Security Policy" in complaints
    assert "http://127.0.0.1:9/x.png" in complaints


INTRUDE = """
const script = document.createElement('script');
script.textContent = 'window.intruder = 1';
const image = document.createElement('img');
image.src = 'http://127.0.0.1:9/x.png';
document.body.append(script, image);
"""


def test_one_time_for_plots_and_bicycle(page: Any) -> None:
    start = page.execute_script(STATE)
    assert start["time"] == 0.0
    data = page.execute_script("return JSON.parse(document.getElementById('report-data').textContent)")
    predicted = data["motions"]["strike-1"]["predicted"]

    # Pointing at a plot: the other plots, the slider and the bicycle follow.
    page.execute_script(POINT, ".figure_3b", "pointermove", 0.5)
    pointed = page.execute_script(STATE)
    assert 1.0 < pointed["time"] < 2.5
    assert len(pointed["cursors"]) == 3
    # The same instant stands at the same place in all plots.
    assert max(pointed["cursors"]) - min(pointed["cursors"]) < 2.0
    assert min(pointed["cursors"]) > max(start["cursors"]) + 100.0
    index = min(range(len(predicted["time"])), key=lambda k: abs(predicted["time"][k] - pointed["time"]))
    degrees = float(pointed["lean"].removeprefix("rotate(").rstrip(")"))
    assert degrees == pytest.approx(57.29578 * predicted["lean"][index], abs=0.3)
    assert f"{pointed['time']:.2f} s" in pointed["words"]
    assert pointed["place"] != start["place"]

    # The keyboard: the slider is reached by Tab and moved by the arrow keys.
    slider = page.find_element("css selector", "#strike-1 input.time")
    page.find_element("css selector", "#strike-1 .play").send_keys(Keys.TAB)
    assert page.switch_to.active_element == slider
    slider.send_keys(Keys.ARROW_RIGHT * 5)
    moved = page.execute_script(STATE)
    assert moved["time"] == pytest.approx(pointed["time"] + 0.05, abs=0.011)
    assert moved["cursors"][0] > pointed["cursors"][0]


STATE = """
const section = document.querySelector('#strike-1');
const cursor = plot => {
  const rules = [...plot.querySelectorAll('.mark-rule line')];
  const rule = rules.find(one => one.getAttribute('stroke') === '#000000');
  return rule.getBoundingClientRect().left;
};
const plots = [...section.querySelectorAll('.figure_3b .plot, .speed .plot')];
return {
  time: Number(section.querySelector('input.time').value),
  cursors: plots.map(cursor),
  lean: section.querySelector('.behind g').getAttribute('transform'),
  place: section.querySelector('.path g').getAttribute('transform'),
  words: section.querySelector('.readout').innerText,
};
"""
POINT = """
const [chart, kind, share] = arguments;
const svg = document.querySelector('#strike-1 ' + chart + ' .plot svg');
const box = svg.getBoundingClientRect();
const at = {bubbles: true, clientX: box.left + share * box.width, clientY: box.top + 60};
svg.dispatchEvent(new PointerEvent(kind, at));
"""


def test_touch_moves_the_time(page: Any) -> None:
    page.execute_script(POINT, ".speed", "pointerdown", 0.8)
    assert page.execute_script(STATE)["time"] > 2.5


def test_animation_plays_to_its_end_and_stops(page: Any) -> None:
    page.execute_script(PLAY)
    wait(page, "return document.querySelector('#strike-1 .play').innerText === 'Play'")
    slider = page.find_element("css selector", "#strike-1 input.time")
    value, most = (float(slider.get_property(name)) for name in ("value", "max"))
    assert value == pytest.approx(most, abs=0.011)


PLAY = """
const slider = document.querySelector('#strike-1 input.time');
slider.value = Number(slider.max) - 0.3;
slider.dispatchEvent(new Event('input'));
document.querySelector('#strike-1 .play').click();
"""


@pytest.mark.parametrize("width", [390, 1366])
def test_nothing_sticks_out_and_no_labels_overlap(browser: Any, report: Path, width: int) -> None:
    page = opened(browser, report, width)
    assert page.execute_script("return document.documentElement.scrollWidth") <= width
    assert page.execute_script(OUTSIDE) == []
    assert page.execute_script(OVERLAPS) == []


OUTSIDE = """
return [...document.querySelectorAll('.plot')].flatMap(plot => {
  const box = plot.getBoundingClientRect();
  return [...plot.querySelectorAll('text')].filter(text => {
    const t = text.getBoundingClientRect();
    return t.width && (t.left < box.left - 1 || t.right > box.right + 1 || t.bottom > box.bottom + 1);
  }).map(text => text.textContent);
});
"""
OVERLAPS = """
const meet = (a, b) =>
  a.left < b.right - 1 && b.left < a.right - 1 && a.top < b.bottom - 1 && b.top < a.bottom - 1;
const seen = text => text.textContent && Number(text.getAttribute('opacity') ?? 1) > 0;
return [...document.querySelectorAll('.plot')].flatMap(plot => {
  const texts = [...plot.querySelectorAll('text')].filter(seen);
  const labels = texts.map(text => [text.textContent, text.getBoundingClientRect()]);
  return labels.flatMap(([name, box], i) =>
    labels.slice(i + 1).filter(([, other]) => meet(box, other)).map(([other]) => name + ' / ' + other));
});
"""


def test_prints_without_a_cut_plot(page: Any) -> None:
    # Every figure is shorter than a page, may not be broken, and is no wider than A4 less 15 mm margins.
    page.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": "print"})
    size = {"width": 680, "height": 1009, "deviceScaleFactor": 1, "mobile": False}
    page.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
    try:
        figures = page.execute_script(FIGURES)
    finally:
        page.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": ""})
    assert len(figures) >= 5
    for height, kept, right, edge in figures:
        assert height < 1009
        assert kept == "avoid"
        assert right <= edge + 1


FIGURES = """
return [...document.querySelectorAll('figure.chart')].map(figure => [
  figure.getBoundingClientRect().height,
  getComputedStyle(figure).breakInside,
  Math.max(...[...figure.querySelectorAll('svg')].map(svg => svg.getBoundingClientRect().right)),
  figure.getBoundingClientRect().right,
]);
"""


def test_printing_draws_what_was_not_yet_seen(browser: Any, report: Path) -> None:
    size = {"width": 1366, "height": 300, "deviceScaleFactor": 1, "mobile": False}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
    browser.get(report.as_uri())
    drawn = "return document.querySelectorAll('.plot svg').length"
    few = browser.execute_script(drawn)
    printed = browser.execute_cdp_cmd("Page.printToPDF", {"paperWidth": 8.27, "paperHeight": 11.69})
    assert base64.b64decode(printed["data"]).startswith(b"%PDF")
    there = browser.execute_script("return document.querySelectorAll('.plot').length")
    assert few < there == browser.execute_script(drawn)
