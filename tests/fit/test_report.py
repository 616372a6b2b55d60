"""`fit report`: one file that holds everything, says what it rests on, and shows what `fit run` answers."""

from __future__ import annotations

import hashlib
import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.signal import periodogram
from tms_bag import BagWriter
from tms_fit.report.element import element, markup
from tms_fit.report.filtered import share_inside
from tms_fit.report.rounding import as_sentence, decimals, fixed
from tms_fit.report.timeline import gaps_of
from tms_fit.report.whiteness import autocorrelation, power_density
from tms_sim.run import SimulatedRun


def write(path: Path, records: Any) -> Path:
    with BagWriter(path) as bag:
        for record in records:
            bag.write(record)
    return path


class Page(HTMLParser):
    """What a reader without JavaScript sees, and the elements behind it."""

    def __init__(self, path: Path) -> None:
        super().__init__(convert_charrefs=True)
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.scripts: list[str] = []
        self.words: list[str] = []
        self._inside: list[str] = []
        self.source = path.read_text(encoding="utf-8")
        self.feed(self.source)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attrs)))
        if tag not in ("meta", "input"):
            self._inside.append(tag)

    def handle_endtag(self, tag: str) -> None:
        while self._inside and self._inside.pop() != tag:
            pass

    def handle_data(self, data: str) -> None:
        if "script" in self._inside:
            self.scripts.append(data)
        elif "style" not in self._inside and data.strip():
            self.words.append(data)

    @property
    def text(self) -> str:
        return " ".join(" ".join(self.words).split())

    @property
    def data(self) -> dict[str, Any]:
        found: dict[str, Any] = json.loads(self.scripts[0])
        return found


@pytest.fixture(scope="module")
def run(make_run: Any) -> SimulatedRun:
    made: SimulatedRun = make_run("tms_strike", strike__time=1.5037, duration=4.5)
    return made


@pytest.fixture(scope="module")
def bag(run: SimulatedRun, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write(tmp_path_factory.mktemp("report") / "bag", run.records())


@pytest.fixture(scope="module")
def made() -> dict[tuple[str, ...], Page]:
    """Reports that were made before."""
    return {}


@pytest.fixture
def report(command: Any, tmp_path: Path, made: dict[tuple[str, ...], Page]) -> Any:
    def make(bag: Path, *options: object) -> Page:
        key = (str(bag), *map(str, options))
        if key not in made:
            path = tmp_path / "report.html"
            done = command("tms_fit", "report", bag, "-o", path, *options)
            assert (done.code, done.out, done.err) == (0, "", "")
            made[key] = Page(path)
        return made[key]

    return make


def numbers(value: Any) -> Iterator[float]:
    """Values and ends of intervals of a document of `fit run --json`."""
    for strike in value["strikes"]:
        for estimate in strike["estimates"]:
            for parameter in estimate["parameters"].values():
                yield from (parameter["value"], parameter["std"], *parameter["ci95"])


def test_numbers_are_those_of_fit_run(command: Any, report: Any, bag: Path) -> None:
    words = (
        "--free",
        "initial_lean_rate,initial_steer_rate",
        "--window",
        1.2,
        "--estimator",
        "least_squares",
    )
    expected = json.loads(command("tms_fit", "run", bag, "--json", *words).out)
    shown = {
        float(str(attributes["value"])) for tag, attributes in report(bag, *words).elements if tag == "data"
    }
    assert len(list(numbers(expected))) == 8
    assert set(numbers(expected)) <= shown


def test_profiles_end_where_fit_run_says(command: Any, report: Any, bag: Path) -> None:
    words = ("--free", "initial_lean_rate,speed", "--window", 1.2, "--estimator", "least_squares")
    done = command("tms_fit", "run", bag, "--json", "--intervals", "profile", *words)
    parameters = json.loads(done.out)["strikes"][0]["estimates"][0]["parameters"]
    data = report(bag, *words).data["data"]["strike-1"]
    assert data["profile_speed_ends"]["value"] == pytest.approx(parameters["speed"]["ci95"], rel=1e-5)
    assert "profile_initial_lean_rate" not in data  # straight by nature


def test_findings_are_those_of_fit_run(command: Any, report: Any, bag: Path) -> None:
    document = json.loads(command("tms_fit", "run", bag, "--json", "--hypotheses").out)
    (strike,) = document["strikes"]
    page = report(bag)
    shown = {float(str(attributes["value"])) for tag, attributes in page.elements if tag == "data"}
    for one in strike["hypotheses"]:
        assert as_sentence(one["sentence"]) in page.text or one["p_value"] >= 1e-3
        assert {one["value"], one["assumed"]} <= {*shown, None}
    for test in strike["estimates"][0]["criticism"]["tests"]:
        assert as_sentence(test["sentence"]) in page.text


def test_header_tells_what_it_rests_on(command: Any, report: Any, bag: Path) -> None:
    text = report(bag).text
    (file,) = bag.glob("*.mcap")
    assert hashlib.sha256(file.read_bytes()).hexdigest() in text
    matrices = json.loads(command("tms_model", "matrices", "tms_eq_10_1", "--json").out)
    exact = json.dumps({key: matrices[key] for key in ("M", "C1", "K0", "K2")}, separators=(",", ":"))
    assert hashlib.sha256(exact.encode()).hexdigest() in text
    for said in ("This run is simulated", "window 1.5", "tms_sim, scenario tms_strike", "seed 1", "numpy"):
        assert said in text


def test_sentence_in_plain_words(command: Any, report: Any, bag: Path) -> None:
    document = json.loads(command("tms_fit", "run", bag, "--json").out)
    parameter = document["strikes"][0]["estimates"][0]["parameters"]["initial_lean_rate"]
    text = report(bag).text
    assert "was struck to the right" in text
    rounded = fixed(parameter["value"], decimals(parameter["std"]))
    assert re.search(rf"began to lean at {re.escape(rounded)} rad/s \(95 % interval \S+ to \S+ rad/s", text)


def test_a_push_to_the_left_is_said(make_run: Any, report: Any, tmp_path: Path) -> None:
    run = make_run("tms_strike", strike__time=1.5, duration=4.0, strike__lean_rate=-0.4)
    page = report(write(tmp_path / "left", run.records()))
    assert "struck to the left" in page.text
    assert "\u22120.4" in page.text  # a proper minus


def test_same_bag_same_bytes(command: Any, report: Any, bag: Path, tmp_path: Path) -> None:
    command("tms_fit", "report", bag, "-o", tmp_path / "report.html")
    assert Page(tmp_path / "report.html").source == report(bag).source
    assert [path.name for path in tmp_path.iterdir() if "unfinished" in path.name] == []


EVIL = "</script><script>alert(1)</script><img src=x onerror=alert(2)>\"'&\u202e"


def test_what_a_bag_says_is_never_markup(report: Any, run: SimulatedRun, tmp_path: Path, bag: Path) -> None:
    plain = report(bag, "--bicycle", "tms_eq_10_1")
    info = replace(run.info, bicycle=EVIL, source=EVIL, version=EVIL, source_sha256=EVIL, configuration=EVIL)
    imu = replace(run.imu, frame_id=EVIL)
    named = write(tmp_path / "<b>&bag", replace(run, info=info, imu=imu).records())
    evil = report(named, "--bicycle", "tms_eq_10_1")
    tags = [[tag for tag, _ in page.elements if tag not in ("dt", "dd")] for page in (evil, plain)]
    assert tags[0] == tags[1]  # the header has more lines, nothing else differs
    assert not any(name.startswith("on") for _, attributes in evil.elements for name in attributes)
    assert "<script>alert(1)</script>" in evil.text  # to be read, not run
    assert "\u202e" not in evil.text
    assert len(evil.scripts) == len(plain.scripts) == 3


def test_elements_escape_their_text() -> None:
    made = markup(element("p", "a<b>&", element("i", "\x00"), "</p>", title='"><script>'))
    # Inside double quotes '<' ends nothing, and the quote is escaped.
    assert made == '<p title="&quot;&gt;<script&gt;">a&lt;b&gt;&amp;<i>\ufffd</i>&lt;/p&gt;</p>'


def test_policy_forbids_everything_but_the_file_itself(report: Any, bag: Path) -> None:
    page = report(bag)
    (policy,) = (
        str(attributes["content"])
        for tag, attributes in page.elements
        if tag == "meta" and attributes.get("http-equiv") == "Content-Security-Policy"
    )
    assert policy.startswith("default-src 'none';")
    assert "unsafe" not in policy
    assert "http" not in policy
    linked = {
        value
        for tag, attributes in page.elements
        for name, value in attributes.items()
        if name in ("src", "href", "data", "action") and tag != "a"
    }
    assert linked == set()
    assert all(str(a["href"]).startswith("#") for tag, a in page.elements if tag == "a")
    assert len(page.source.encode()) < 2_000_000


def test_twenty_strikes_stay_light(report: Any, bag: Path) -> None:
    # Library, style and script are there once, the rest at most once per strike.
    page = report(bag)
    once = len(page.source) - len(page.scripts[0])
    assert once + 20 * len(page.scripts[0]) < 5_000_000


def test_no_strike_is_said(make_run: Any, report: Any, tmp_path: Path) -> None:
    run = make_run("tms_strike", strike__lean_rate=0.0, duration=3.0)
    page = report(write(tmp_path / "quiet", run.records()))
    assert "No strike was found" in page.text
    assert {a["data-section"] for _, a in page.elements if a.get("class") == "plot"} == {"recording"}


def test_what_is_not_there_is_not_drawn(run: SimulatedRun, report: Any, tmp_path: Path) -> None:
    # Lean rate and speed as one number only: no yaw gyroscope, no speed sensor, no truth.
    lean_only = np.where([True, False, False], run.imu.angular_velocity, np.nan)
    bare = replace(
        run,
        imu=replace(run.imu, angular_velocity=lean_only),
        info=replace(run.info, simulated=False),
    )
    kept = ("/imu/data_raw", "/run_info")
    page = report(write(tmp_path / "bare", [one for one in bare.records() if one.topic in kept]))
    assert "A measured run." in page.text
    assert "simulated" not in page.text
    assert "The yaw rate was not measured" in page.text
    assert "Against the truth" not in page.text
    data = page.data["data"]["strike-1"]
    assert not {"truth", "speed", "histogram_yaw_rate"} & set(data)
    assert set(data["series"]["yaw_rate"]) == {None}


@pytest.mark.parametrize(
    ("words", "channel"),
    [(("--estimator", "som2011"), "lean_rate"), (("--channels", "yaw_rate"), "yaw_rate")],
)
def test_residuals_are_those_of_the_channels_used(report: Any, bag: Path, words: Any, channel: str) -> None:
    data = report(bag, *words).data["data"]["strike-1"]
    assert {name for name in data if name.startswith("histogram")} == {f"histogram_{channel}"}
    assert set(data["spectrum"]["channel"]) == set(data["autocorrelation"]["channel"]) == {channel}


@pytest.mark.parametrize("slip", ["leave_out", "yaw_offset"])
def test_slip_window_is_shaded(report: Any, bag: Path, slip: str) -> None:
    page = report(bag, "--slip-window", 0.25, "--slip", slip)
    assert page.data["data"]["strike-1"]["slip_window"] == {"start": [0.0], "end": [0.25]}
    assert ("left out" if slip == "leave_out" else "in the model") in json.dumps(page.data["specs"])
    assert "slip_window" not in report(bag).data["data"]["strike-1"]


@pytest.mark.long
def test_a_prediction_that_runs_away_is_not_drawn(report: Any, bag: Path) -> None:
    data = report(bag, "--fix", "speed=0.3").data["data"]["strike-1"]["series"]
    largest = max(abs(one) for one in data["lean_rate"] if one is not None)
    predicted = [one for one in data["lean_rate_predicted"] if one is not None]
    assert len(predicted) > 100
    assert max(map(abs, predicted)) < 4 * largest


def test_simulated_runs_are_compared_with_the_truth(report: Any, bag: Path, run: SimulatedRun) -> None:
    page = report(bag)
    assert "Against the truth" in page.text
    truth = page.data["data"]["strike-1"]["truth"]
    assert max(truth["lean_rate"]) == pytest.approx(0.5, abs=0.01)
    motions = page.data["motions"]["strike-1"]
    assert set(motions) == {"predicted", "true"}
    # Both paths start at the same place and heading; 2 s later they are centimetres apart, not metres.
    for name in ("x", "y"):
        ends = [np.interp(2.0, motion["time"], motion[name]) for motion in motions.values()]
        assert ends[0] == pytest.approx(ends[1], abs=0.1)
    assert (
        np.interp(2.0, motions["true"]["time"], motions["true"]["y"]) > 0.5
    )  # struck and turned to the right


@pytest.mark.parametrize("share", [0.3, 0.6, 0.97])
@pytest.mark.quick_for(share=[0.3, 0.97])
def test_truncated_bags(command: Any, bag: Path, tmp_path: Path, share: float) -> None:
    (whole,) = bag.glob("*.mcap")
    (tmp_path / "cut.mcap").write_bytes(whole.read_bytes()[: int(share * whole.stat().st_size)])
    done = command("tms_fit", "report", tmp_path / "cut.mcap", "-o", tmp_path / "report.html")
    assert done.code in (0, 2)
    assert (done.code == 0) == (tmp_path / "report.html").exists()
    if done.code == 2:
        assert done.err.count("\n") == 1


@pytest.mark.long
def test_figures_for_papers(command: Any, bag: Path, tmp_path: Path) -> None:
    folder = tmp_path / "figures"
    done = command("tms_fit", "report", bag, "-o", tmp_path / "report.html", "--figures", folder)
    assert (done.code, done.out, done.err) == (0, "", "")
    charts = {
        attributes.get("class")
        for tag, attributes in Page(tmp_path / "report.html").elements
        if tag == "figure"
    }
    names = {str(name).split()[1] for name in charts if name}
    starts = {".png": b"\x89PNG", ".svg": b"<svg", ".pdf": b"%PDF"}
    assert {path.name for path in folder.iterdir()} == {
        f"{'recording' if name == 'timeline' else 'strike_1'}_{name}{suffix}"
        for name in names
        for suffix in starts
    }
    for path in folder.iterdir():
        assert path.read_bytes().startswith(starts[path.suffix])
    drawn = (folder / "strike_1_figure_3b.svg").read_text()
    assert "lean rate [rad/s]" in drawn
    assert "yaw rate [rad/s]" in drawn


def test_what_is_missing_is_counted() -> None:
    # 100 Hz with samples 3, 4 and 8 lost: two gaps, three samples.
    kept = np.delete(np.arange(20), [3, 4, 8]) * 10_000_000
    assert gaps_of(kept) == ([(20_000_000, 50_000_000), (70_000_000, 90_000_000)], 3)
    assert gaps_of(np.arange(20) * 10_000_000) == ([], 0)
    assert gaps_of(np.array([5])) == ([], 0)


@pytest.mark.long
def test_recording_tells_losses_limits_and_the_truth(make_run: Any, report: Any, tmp_path: Path) -> None:
    run = make_run("gym_run", strike__time=3.0, duration=6.0, run_up__duration=1.0)
    kept = np.delete(np.arange(len(run.imu.time_ns)), [100, 101])
    imu = replace(
        run.imu,
        time_ns=run.imu.time_ns[kept],
        angular_velocity=run.imu.angular_velocity[kept],
        specific_force=run.imu.specific_force[kept],
    )
    flags = run.lean_yaw.saturation.copy()
    flags[50:53] |= 2
    lean_yaw = replace(run.lean_yaw, saturation=flags)
    page = report(write(tmp_path / "gym", replace(run, imu=imu, lean_yaw=lean_yaw).records()))
    assert "2 are missing, in 1 gap." in page.text
    assert f"{np.count_nonzero(flags)} samples are marked as at the sensor's limit" in page.text
    spans = page.data["data"]["recording"]["spans"]
    kinds = set(spans["kind"])
    assert {"strike", "samples missing", "accelerometer at its limit", "truth: strike"} <= kinds
    first, last = ((run.lean_yaw.time_ns[k] - run.info.start_ns) / 1e9 for k in (50, 52))
    spans = {(k, f, n) for k, f, n in zip(spans["kind"], spans["first"], spans["last"], strict=True)}
    assert any(
        k == "accelerometer at its limit" and (f, n) == pytest.approx((first, last), abs=1e-4)
        for k, f, n in spans
    )


def test_spectrum_of_even_samples_is_the_periodogram() -> None:
    rng = np.random.default_rng(4)
    time = np.arange(151) / 100.0
    values = rng.normal(size=151) + 3.0 * np.sin(2.0 * np.pi * 20.0 * time)
    frequency, density = power_density(time, values, 0.01)
    expected_frequency, expected = periodogram(values, fs=100.0, detrend="constant")
    np.testing.assert_allclose(frequency, expected_frequency[1:], rtol=1e-12)
    np.testing.assert_allclose(density, expected[1:], rtol=1e-9)
    assert frequency[np.argmax(density)] == pytest.approx(20.0, abs=0.7)
    # With a third of the samples lost the 20 Hz still stand out.
    kept = rng.random(151) > 0.33
    frequency, density = power_density(time[kept], values[kept], 0.01)
    assert frequency[np.argmax(density)] == pytest.approx(20.0, abs=0.7)


def test_autocorrelation_by_hand() -> None:
    # +1, -1, +1, ...: neighbours are opposite, every second one alike. 40 values: 39 products of -1 over 40.
    residual = np.stack([np.tile([1.0, -1.0], 20), np.full(40, np.nan)], axis=1)
    columns = autocorrelation(np.arange(40) / 100.0, residual)
    assert set(columns["channel"]) == {"lean_rate"}
    np.testing.assert_allclose(columns["value"][:2], [-39 / 40, 38 / 40], rtol=1e-5)
    assert columns["lag"][:2] == [0.01, 0.02]
    assert columns["limit"][0] == pytest.approx(1.96 / np.sqrt(40), rel=1e-5)


def test_nis_keeps_to_its_band_when_noise_is_right(report: Any, bag: Path) -> None:
    # 95 % of 301 to 351 values: the share's standard deviation is 1.2 %. The filter allows for disturbances
    # that this run does not have, so that it may lie above, not below.
    page = report(bag)
    columns = page.data["data"]["strike-1"]["nis"]
    assert len(columns["nis"]) > 250
    assert share_inside(columns) > 0.95 - 4 * 0.0125
    np.testing.assert_allclose(columns["high"], 7.3778, rtol=1e-4)  # chi square, 2 channels, 97.5 %


@pytest.mark.long
def test_a_prediction_ends_where_its_speed_is_not_known(
    command: Any, run: SimulatedRun, tmp_path: Path
) -> None:
    # The speed sensor tells a fall that gets steeper; a cubic through 1.5 s of it would soon be negative.
    seconds = (run.speed.time_ns - run.info.start_ns) / 1e9 - 1.5
    falling = 3.6 - 0.8 * np.maximum(seconds, 0.0) ** 3 / 1.5**3
    speed = replace(run.speed, speed=falling + 1e-3 * np.sin(50.0 * seconds))
    bag = write(tmp_path / "falling", replace(run, speed=speed).records())
    done = command("tms_fit", "report", bag, "--speed-model", "measured", "-o", tmp_path / "report.html")
    assert (done.code, done.err) == (0, "")
    shown = Page(tmp_path / "report.html").data["data"]["strike-1"]["used_speed"]
    assert 1.4 < shown["time"][-1] < 2.5
    assert min(shown["speed"]) > 0.85 * (3.6 - 0.8)


REFUSED = {
    "another kind": ("report.pdf", "expected a name that ends in .html"),
    "no kind": ("report", "expected a name that ends in .html"),
    "inside a file": ("/dev/null/report.html", "expected a place to write a file"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_refused(refused: Any, bag: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, case: str) -> None:
    monkeypatch.chdir(tmp_path)
    output, said = REFUSED[case]
    assert said in refused("tms_fit", "report", bag, "-o", output)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("after", [0.3, 1.0, 1.6])
@pytest.mark.quick_for(after=[1.0])
def test_killed_half_way_leaves_nothing_half_written(bag: Path, tmp_path: Path, after: float) -> None:
    (tmp_path / "report.html").write_text("the old one")
    command = [sys.executable, "-m", "tms_fit", "report", str(bag), "-o", str(tmp_path / "report.html")]
    process = subprocess.Popen(command, stderr=subprocess.PIPE)
    time.sleep(after)
    os.kill(process.pid, signal.SIGINT)
    process.communicate()
    content = (tmp_path / "report.html").read_text()
    assert content == "the old one" or content.endswith("</html>\n")
    assert [path.name for path in tmp_path.iterdir()] == ["report.html"]


@pytest.mark.parametrize(
    ("std", "places"),
    [(0.0027, 4), (0.027, 3), (0.0996, 2), (0.0994, 3), (1.0, 1), (27.0, 0), (float("nan"), 4), (1e-12, 9)],
)
def test_two_digits_of_the_standard_error(std: float, places: int) -> None:
    assert decimals(std) == places


def test_signs_are_typeset() -> None:
    assert as_sentence("a gain of -1.2 +- 0.1, p < 1e-6, Ljung-Box") == (
        "A gain of \u22121.2 \u00b1 0.1, p < 1e-6, Ljung-Box."
    )


def test_minus_and_nothing() -> None:
    assert (fixed(-0.0001, 2), fixed(-1.25, 1), fixed(float("nan"), 2)) == ("0.00", "\u22121.2", "\u2013")
