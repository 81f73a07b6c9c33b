"""Checks a page of rollouts in headless Chromium against the artifacts from which it was made.

    python tests/report_page.py PAGE.html ARTIFACT...

Needs selenium, polars, and Debian's chromium and chromium-driver. Exits with code 1 and a sentence about the first difference.
"""

import base64
import json
import math
import struct
import sys
import tempfile
from pathlib import Path

import browser
import polars as pl
from selenium.webdriver.common.by import By
from selenium.webdriver.common.keys import Keys
from selenium.webdriver.support.ui import Select

METRICS = ["score_scaled_mean", "coverage_raw_mean", "iou_mean", "success_rate"]
RESULTS = {"score": "score_max", "coverage": "coverage_max", "iou": "iou_max", "coverage_final": "coverage_final",
           "steps": "steps", "decisions": "decisions", "success": "success"}


def check(condition, message):
    if not condition:
        sys.exit(message)


def equal(found, expected, what):
    check(found == expected, f"{what}: the page has {found!r}, the artifact {expected!r}")


class Artifact:
    """Manifest and tables of a rollouts artifact."""

    def __init__(self, folder):
        self.manifest = json.loads((folder / "manifest.json").read_text())
        tables = {name: pl.read_parquet(folder / f"{name}.parquet") for name in ["results", "steps", "decisions"]}
        self.results, self.steps = tables["results"], tables["steps"]
        details = pl.read_parquet(folder / "decisions_re4.parquet")
        self.decisions = tables["decisions"].join(details, on=["seed", "decision"], maintain_order="left")

    def decision(self, seed, step):
        """The decision to which the action of a step belongs."""
        steps = self.steps.filter(pl.col("seed") == seed)
        number = steps["decision"][min(step, steps.height - 1)]
        return self.decisions.filter((pl.col("seed") == seed) & (pl.col("decision") == number)).row(0, named=True)


class Page:
    """The page in a browser."""

    def __init__(self, path, profile, width=1280):
        self.driver = browser.start(profile)
        self.resize(width)
        self.open(path)

    def open(self, path):
        self.driver.get(path.resolve().as_uri())
        browser.wait(self.driver, lambda: self.all("html[data-ready]"))

    def resize(self, width, dark=False):
        size = {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": False}
        self.driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
        scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
        self.driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": [scheme]})
        there = "return innerWidth === arguments[0] && matchMedia('(prefers-color-scheme: dark)').matches === arguments[1]"
        browser.wait(self.driver, lambda: self.run(there, width, dark))

    def run(self, script, *arguments):
        return self.driver.execute_script(script, *arguments)

    def one(self, selector):
        return self.driver.find_element(By.CSS_SELECTOR, selector)

    def all(self, selector):
        return self.driver.find_elements(By.CSS_SELECTOR, selector)

    def number(self, selector, attribute):
        return float(self.one(selector).get_attribute(attribute))

    def step(self):
        return int(self.one("#step-text").get_attribute("data-step"))

    def image(self):
        return self.run("return document.querySelector('#scene svg').innerHTML")

    def scrub(self, step):
        self.run("const s = document.getElementById('scrubber'); s.value = arguments[0]; "
                 "s.dispatchEvent(new Event('input', {bubbles: true}))", step)

    def press(self, key, times=1):
        scrubber = self.one("#scrubber")
        for _ in range(times):
            scrubber.send_keys(key)

    def log(self):
        return [entry for entry in self.driver.get_log("browser")]


def with_estimates(path, target):
    """Writes the page as for a policy that observed estimated poses, which are off by 3 px and 0.1 rad, with confidence 0.75."""
    before, rest = path.read_text().split('type="application/json">', 1)
    text, after = rest.split("</script>", 1)
    report = json.loads(text)
    artifact = report["artifacts"][0]
    shown = artifact["shown"]
    starts = struct.iter_unpack("<5f", base64.b64decode(artifact["starts"]["data"]))
    after_steps = struct.iter_unpack("<3f", base64.b64decode(artifact["steps"]["object"]["data"]))
    poses = []
    for rollout, start in zip(shown, starts):
        states = [start[2:], *(next(after_steps) for _ in range(artifact["rollouts"]["steps"][rollout]))]
        poses += [(x + 3, y, theta + 0.1) for x, y, theta in states[:-1]]
    packed = b"".join(struct.pack("<3f", *pose) for pose in poses)
    artifact["steps"]["observed"] = {"type": "f32", "data": base64.b64encode(packed).decode()}
    packed = struct.pack("<d", 0.75) * len(poses)
    artifact["steps"]["confidence"] = {"type": "f64", "data": base64.b64encode(packed).decode()}
    text = json.dumps(report).replace("<", "\\u003c")
    target.write_text(f'{before}type="application/json">{text}</script>{after}')


def scores_match_the_manifest(page, artifacts):
    for artifact in artifacts:
        row = f"tr[data-artifact='{artifact.manifest['key']}']"
        for metric in METRICS:
            stated = artifact.manifest["summary"]["metrics"][metric]
            for part in ["value", "low", "high"]:
                found = page.number(f"{row} [data-metric={metric}]", f"data-{part}")
                equal(found, stated[part], f"{metric} {part}")
            words = page.one(f"{row} [data-metric={metric}] .value").text
            equal(words, f"{stated['value']:.3f}", f"{metric} in words")


def budgets_match_the_steps(page, artifacts):
    for number, artifact in enumerate(artifacts):
        for row in page.all(f"#budgets tr[data-series='{number}']"):
            budget = int(row.get_attribute("data-budget"))
            within = artifact.steps.filter(pl.col("step") < budget).group_by("seed").agg(pl.col("score", "coverage").max())
            for measure in ["score", "coverage"]:
                cell = row.find_element(By.CSS_SELECTOR, f"[data-budget-metric={measure}]")
                found, expected = float(cell.get_attribute("data-value")), within[measure].mean()
                check(math.isclose(found, expected, rel_tol=1e-12), f"{measure} at {budget}: {found} is not {expected}")


def seeds_match_the_results(page, number, artifact):
    Select(page.one("#pick-artifact")).select_by_value(str(number))
    rows = page.all("#seeds tbody tr")
    equal(len(rows), artifact.results.height, "rows of the table of seeds")
    cells = page.run("return [...document.querySelectorAll('#seeds tbody tr')].map(row => Object.fromEntries("
                     "[...row.cells].map(cell => [cell.dataset.column, Number(cell.dataset.value)])))")
    for shown, stated in zip(cells, artifact.results.sort("seed").iter_rows(named=True)):
        for column, name in RESULTS.items():
            equal(shown[column], float(stated[name]), f"seed {stated['seed']}, {name}")


def columns_sort(page):
    button = page.one("#seeds th button[data-column=score]")
    read = "return [...document.querySelectorAll('#seeds td[data-column=score]')].map(cell => Number(cell.dataset.value))"
    page.run("arguments[0].click()", button)
    check(page.run(read) == sorted(page.run(read)), "the table of seeds is not sorted by score")
    page.run("arguments[0].click()", button)
    check(page.run(read) == sorted(page.run(read), reverse=True), "the table of seeds is not sorted by descending score")
    page.run("document.querySelector('#seeds th button[data-column=seed]').click()")


def plots_are_rendered(page, artifacts):
    rollouts = sum(artifact.results.height for artifact in artifacts)
    for order in ["rank", "seed"]:
        for measure in ["score", "coverage", "iou"]:
            for name, value in [("order", order), ("measure", measure)]:
                page.run("document.querySelector(`input[name=${arguments[0]}][value=${arguments[1]}]`).click()", name, value)
            equal(len(page.all("#seed-plot .point")), rollouts, f"marks by {order} and {measure}")
    equal(len(page.all("#budget-plot .curve")), len(artifacts), "budget curves")
    last = artifacts[-1].results.height - 1
    mark = page.one(f"#seed-plot .point[data-artifact='{len(artifacts) - 1}'][data-rollout='{last}']")
    page.run("arguments[0].dispatchEvent(new MouseEvent('click', {bubbles: true}))", mark)
    seed = artifacts[-1].results["seed"][last]
    check(f" {seed} · " in page.one("#scene-caption").text, "a click on a mark does not select its rollout")
    check("selected" in mark.get_attribute("class"), "the chosen mark is not marked")


def seeds_can_be_chosen(page, artifact):
    Select(page.one("#pick-artifact")).select_by_value("0")
    seeds = artifact.results["seed"].to_list()
    picker = Select(page.one("#pick-seed"))
    equal([int(option.text) for option in picker.options], seeds, "seeds to choose from")
    images = set()
    for seed in seeds[:3]:
        Select(page.one("#pick-seed")).select_by_visible_text(str(seed))
        check(f" {seed} · " in page.one("#scene-caption").text, f"seed {seed} is not shown")
        equal(page.step(), 0, "step of a rollout that was just chosen")
        images.add(page.image())
    equal(len(images), 3, "images of three seeds")
    page.one("#previous-seed").click()
    check(f" {seeds[1]} · " in page.one("#scene-caption").text, "the button for the previous seed does nothing")
    button = page.one(f"#seeds tr[data-seed='{seeds[4]}'] button")
    page.run("arguments[0].click()", button)
    check(f" {seeds[4]} · " in page.one("#scene-caption").text, "a row of the table of seeds cannot be selected")


def scrubbing_shows_each_state(page, artifact):
    seed = artifact.results["seed"][0]
    Select(page.one("#pick-seed")).select_by_visible_text(str(seed))
    steps = artifact.steps.filter(pl.col("seed") == seed)
    seen = set()
    # Includes the largest change of coverage, where the value of a neighbouring step would be noticed.
    jump = steps["coverage"].diff().abs().arg_max() + 1
    for step in sorted({0, 1, jump - 1, jump, steps.height // 2, steps.height - 1, steps.height}):
        page.scrub(step)
        equal(page.step(), step, "step after scrubbing")
        check(f"Step {step} of {steps.height}" in page.one("#step-text").text, f"the text of step {step}")
        if step > 0:
            coverage = float(page.one("#step-text").get_attribute("data-coverage"))
            equal(coverage, steps["coverage"][step - 1], f"coverage after step {step}")
        decision_matches_the_tables(page, artifact.decision(seed, step))
        seen.add(page.image())
    check(len(seen) >= 5, "the image does not follow the scrubber")


def decision_matches_the_tables(page, decision):
    at = f"decision {decision['decision']}"
    fact = lambda name: page.one(f"#summary [data-fact={name}]").get_attribute("data-value")
    equal(page.one("#reason").text, decision["reason"] + ".", f"{at}, reason")
    check(page.one("#decision-title").text.startswith(f"Decision {decision['decision'] + 1} of "), f"{at}, title")
    equal(fact("demo_name"), decision["demo_name"], f"{at}, demonstration")
    equal(float(fact("predicted_coverage")), decision["predicted_coverage"], f"{at}, expected coverage")
    equal([float(v) for v in fact("delta").split()], [decision[f"delta_{a}"] for a in ["x", "y", "theta"]], f"{at}, delta")
    equal(int(fact("compared")), decision["compared"], f"{at}, compared")
    for name in ["d_q", "d_o"]:
        if decision[name] is not None:
            equal(float(fact(name)), decision[name], f"{at}, {name}")
        else:
            check(not page.all(f"#summary [data-fact={name}]"), f"{at}: {name} is shown, but the artifact has none")


def chunk_is_moved_by_delta(page, artifact):
    """With Reframe, the chunk begins at the set-point, because delta moves the demonstration's pusher there."""
    seed = artifact.results["seed"][0]
    Select(page.one("#pick-seed")).select_by_visible_text(str(seed))
    page.scrub(0)
    decision = artifact.decision(seed, 0)
    has_frames = page.run("return Object.keys(JSON.parse(document.getElementById('report-data').textContent).demonstrations).length") > 0
    path = page.one("#scene .chunk").get_attribute("d")
    hidden = "gone" in (page.one("#demo svg").get_attribute("class") or "")
    check(has_frames != hidden, "the recorded frame has to be shown if and only if the page has it")
    if not has_frames:
        equal(path or "", "", "chunk of an unknown demonstration")
        check("cannot be shown" in page.one("#demo-note").text, "no word about the missing index")
        return
    start = [float(v) for v in path[1:].split("L")[0].split()]
    for found, axis in zip(start, "xy"):
        check(abs(found - decision[f"set_point_{axis}"]) < 0.02, f"the chunk begins at {start}, not at the set-point")
    check(f"{decision['demo_name']}: frame {decision['demo_frame']}" in page.one("#demo-note").text, "the text under the recorded frame is wrong")


def keys_step_through(page, artifact):
    page.scrub(0)
    page.press(Keys.ARROW_RIGHT, 3)
    equal(page.step(), 3, "step after three times right")
    page.press(Keys.ARROW_LEFT)
    equal(page.step(), 2, "step after left")
    seed = artifact.results["seed"][0]
    starts = artifact.decisions.filter(pl.col("seed") == seed)["step"].to_list()
    length = artifact.steps.filter(pl.col("seed") == seed).height
    second, third = [*(s for s in starts if s > 2), length, length][:2]
    page.press(Keys.ARROW_DOWN)
    equal(page.step(), second, "step of the next decision")
    page.press("]")
    equal(page.step(), third, "step of the decision after it")
    page.press("[")
    equal(page.step(), max(s for s in starts if s < third), "step of the previous decision")
    page.press(Keys.END)
    equal(page.step(), length, "last step")
    page.press(Keys.HOME)
    equal(page.step(), 0, "first step")


def keys_navigate_the_plot(page, artifact):
    page.run("document.querySelector('input[name=order][value=seed]').click()")
    seeds = artifact.results["seed"].to_list()
    Select(page.one("#pick-seed")).select_by_visible_text(str(seeds[0]))
    page.one("#seed-plot svg").send_keys(Keys.ARROW_RIGHT, Keys.ARROW_RIGHT)
    check(f" {seeds[2]} · " in page.one("#scene-caption").text, "arrow keys in the plot do not select the next rollout")


def estimates_are_shown(page):
    """Checks a page made by with_estimates."""
    page.scrub(1)
    outline = page.one("#scene .observed").get_attribute("d")
    check(outline.startswith("M"), "the estimated pose is not shown")
    check(outline != page.one("#scene .block").get_attribute("d"), "the estimated pose is the true one")
    distance, rotation = page.one("#summary [data-fact=pose_error]").get_attribute("data-value").split()
    check(abs(float(distance) - 3) < 1e-3 and abs(float(rotation) - 0.1) < 1e-3, f"the estimate is off by {distance} px, {rotation} rad")
    equal(page.one("#summary [data-fact=pose_confidence]").get_attribute("data-value"), "0.75", "confidence")
    page.press(Keys.END)
    equal(page.one("#scene .observed").get_attribute("d"), "", "estimate after the last action")


# Presses the button in the same task in which the step is found to be above 5, unless the rollout has ended first.
PAUSE = """
const done = arguments[0];
const step = () => Number(document.getElementById("step-text").dataset.step);
const button = document.getElementById("play");
const watch = () => {
  if (button.textContent !== "Pause") return done(null);
  if (step() <= 5) return requestAnimationFrame(watch);
  button.click();
  done(step());
};
watch();
"""


def playback_works(page, speed="5"):
    Select(page.one("#speed")).select_by_value(speed)
    # On a busy machine, a browser's frames can be so far apart that a rollout ends within one, so this is tried several times.
    for _ in range(20):
        page.scrub(0)
        page.run("document.getElementById('play').click()")
        stopped = page.driver.execute_async_script(PAUSE)
        if stopped is not None:
            break
    check(stopped is not None and stopped > 5, f"playing stopped at step {stopped}")
    equal(page.one("#play").text, "Play", "text of the button after a pause")
    page.run("return new Promise(done => setTimeout(done, 300))")
    equal(page.step(), stopped, "step after a pause")


def page_fits_widths_and_schemes(page):
    for width in [1280, 1024, 768, 380]:
        for dark in [False, True]:
            page.resize(width, dark)
            page.run("return new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))")
            wide = page.run("return document.documentElement.scrollWidth")
            check(wide <= width, f"at {width} px the page is {wide} px wide")
    page.resize(1280)


def no_files_were_loaded(page):
    entries = page.run("return performance.getEntriesByType('resource').map(entry => entry.name)")
    check(all(name.startswith("data:") for name in entries), f"the page loaded {entries}")
    log = page.log()
    check(not log, f"the browser's log: {log}")


def main():
    path, *folders = map(Path, sys.argv[1:])
    artifacts = [Artifact(folder) for folder in folders]
    with tempfile.TemporaryDirectory(prefix="re4-chromium-", ignore_cleanup_errors=True) as profile:
        page = Page(path, profile)
        try:
            scores_match_the_manifest(page, artifacts)
            budgets_match_the_steps(page, artifacts)
            for number, artifact in enumerate(artifacts):
                seeds_match_the_results(page, number, artifact)
            columns_sort(page)
            plots_are_rendered(page, artifacts)
            seeds_can_be_chosen(page, artifacts[0])
            scrubbing_shows_each_state(page, artifacts[0])
            chunk_is_moved_by_delta(page, artifacts[0])
            keys_step_through(page, artifacts[0])
            keys_navigate_the_plot(page, artifacts[0])
            playback_works(page)
            page_fits_widths_and_schemes(page)
            no_files_were_loaded(page)
            if artifacts[0].steps["pose_flag"].is_null().all():
                check(not page.all("#scene .observed[d^=M]"), "an estimated pose is shown without estimates")
            estimated = Path(profile) / "estimated.html"
            with_estimates(path, estimated)
            page.open(estimated)
            estimates_are_shown(page)
            no_files_were_loaded(page)
        finally:
            page.driver.quit()
    print(f"{path.name}: the page matches {len(artifacts)} artifacts")


if __name__ == "__main__":
    main()
