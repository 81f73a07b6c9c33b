"""Checks a page of rollouts of robosuite tasks in headless Chromium against the artifacts from which it was made.

    python tests/spatial_report_page.py PAGE.html ARTIFACT...

Needs selenium, polars, and Debian's chromium and chromium-driver. Exits with code 1 and a sentence about the first difference.
"""

import json
import sys
import tempfile
from pathlib import Path

import browser
import polars as pl
from report_page import Page, check, equal, playback_works, no_files_were_loaded, page_fits_widths_and_schemes
from selenium.webdriver.common.by import By
from selenium.webdriver.common.keys import Keys
from selenium.webdriver.support.ui import Select

COLUMNS = ["seed", "success", "steps", "decisions", "demos", "losses", "banned"]


class Artifact:
    """Manifest and tables of a rollouts artifact."""

    def __init__(self, folder):
        self.manifest = json.loads((folder / "manifest.json").read_text())
        tables = {name: pl.read_parquet(folder / f"{name}.parquet") for name in ["results", "steps", "decisions"]}
        self.steps = tables["steps"]
        details = pl.read_parquet(folder / "decisions_re4.parquet")
        self.decisions = tables["decisions"].join(details, on=["seed", "decision"], maintain_order="left")
        counted = self.decisions.group_by("seed").agg(
            demos=pl.col("demo").drop_nulls().n_unique(), losses=(pl.col("kind") == "grasp_lost").sum(), banned=pl.col("banned").last()
        )
        self.results = tables["results"].join(counted, on="seed", how="left", maintain_order="left")

    def of(self, seed):
        return [table.filter(pl.col("seed") == seed) for table in (self.steps, self.decisions)]


def choose(page, filters="all"):
    page.run(f"document.querySelector('input[name=filter][value={filters}]').click()")


def rates_match_the_manifest(page, artifacts):
    for artifact in artifacts:
        cell = f"tr[data-artifact='{artifact.manifest['key']}'] [data-metric=success_rate]"
        for part, value in artifact.manifest["summary"]["metrics"]["success_rate"].items():
            equal(page.number(cell, f"data-{part}"), value, f"success rate, {part}")


def cells_and_rows_follow_the_filter(page, artifacts):
    for filters, holds in [
        ("failure", ~pl.col("success")), ("lost", pl.col("losses") > 0), ("several", pl.col("demos") > 1), ("all", pl.lit(True)),
    ]:
        choose(page, filters)
        for number, artifact in enumerate(artifacts):
            kept = artifact.results.filter(holds)
            equal(len(page.all(f".cells[data-artifact='{number}'] button")), kept.height, f"cells, {filters}")
        Select(page.one("#pick-artifact")).select_by_value("0")
        equal(len(page.all("#seeds tbody tr")), artifacts[0].results.filter(holds).height, f"rows, {filters}")
    for number, artifact in enumerate(artifacts):
        Select(page.one("#pick-artifact")).select_by_value(str(number))
        cells = page.run("return [...document.querySelectorAll('#seeds tbody tr')].map(row => Object.fromEntries("
                         "[...row.cells].map(cell => [cell.dataset.column, Number(cell.dataset.value)])))")
        for shown, stated in zip(cells, artifact.results.sort("seed").iter_rows(named=True)):
            for column in COLUMNS:
                equal(shown[column], float(stated[column]), f"seed {stated['seed']}, {column}")


def cells_can_be_navigated(page, artifact):
    Select(page.one("#pick-artifact")).select_by_value("0")
    seeds = artifact.results["seed"].to_list()
    cell = page.one(".cells[data-artifact='0'] button")
    page.run("arguments[0].click(); arguments[0].focus()", cell)
    page.driver.switch_to.active_element.send_keys(Keys.ARROW_RIGHT)
    check(f"seed {seeds[1]} " in page.one("#scene-caption").text, "the right arrow key does not select the next cell")
    page.driver.switch_to.active_element.send_keys(Keys.ARROW_LEFT)
    check(f"seed {seeds[0]} " in page.one("#scene-caption").text, "the left arrow key does not select the previous cell")


def steps_show_the_tables(page, artifact):
    for seed in artifact.results["seed"].to_list()[:2]:
        Select(page.one("#pick-seed")).select_by_visible_text(str(seed))
        steps, decisions = artifact.of(seed)
        images = set()
        for step in sorted({0, 1, steps.height // 2, steps.height - 1, steps.height}):
            page.scrub(step)
            equal(page.step(), step, "step after scrubbing")
            decision = decisions.row(steps["decision"][min(step, steps.height - 1)], named=True)
            at = f"seed {seed}, step {step}"
            equal(page.one("#reason").text, decision["reason"] + ".", f"{at}, reason")
            fact = lambda name: page.one(f"#summary [data-fact={name}]").get_attribute("data-value")
            equal(fact("kind"), decision["kind"], f"{at}, kind")
            equal(fact("mode"), decision["mode"], f"{at}, mode")
            equal(int(fact("banned")), decision["banned"], f"{at}, banned")
            if decision["demo"] is None:
                check(not page.all("#summary [data-fact=demo_name]"), f"{at}: a demonstration is shown during the return to the home pose")
            else:
                equal(fact("demo_name"), decision["demo_name"], f"{at}, demonstration")
                for name in ["d_q", "d_o", "d_e", "symmetry_rotation", "compared", "replay_steps"]:
                    equal(float(fact(name)), float(decision[name]), f"{at}, {name}")
                delta = [decision[f"delta_{part}"] for part in ["x", "y", "z", "rx", "ry", "rz"]]
                equal([float(v) for v in fact("delta").split()], delta, f"{at}, delta")
                equal(page.one("#step-text").get_attribute("data-demo"), decision["demo_name"], f"{at}, demonstration next to the step")
            if step > 0:
                separation = abs(steps["finger_0"][step - 1] - steps["finger_1"][step - 1])
                check(abs(page.number("#step-text", "data-fingers") - separation) < 1e-7, f"{at}: fingers {separation}")
            images.add(page.image())
        check(len(images) >= 4, "the image does not follow the scrubber")


def images_belong_to_decisions(page, artifact):
    """Images are shown at the decisions that have one, with the axes of the frames and the error of the observed pose."""
    data = page.run("return JSON.parse(document.getElementById('report-data').textContent).artifacts[0]")
    images = data["images"]
    check(images is not None and page.run("return document.querySelectorAll('#camera').length") == 1, "no images")
    seen = set()
    seed = artifact.results.sort("success", "episode")["seed"][0]
    Select(page.one("#pick-seed")).select_by_visible_text(str(seed))
    steps, decisions = artifact.of(seed)
    start = artifact.results.filter(pl.col("seed") == seed).row(0, named=True)
    for decision in decisions.iter_rows(named=True):
        page.scrub(decision["step"])
        at = f"seed {seed}, step {decision['step']}, image"
        check(not page.run("return document.getElementById('camera').hidden"), f"{at}: hidden")
        equal(len(page.all("#camera .estimate")) - len(page.all("#camera .sample .estimate")), 3, f"{at}, axes")
        before = start if decision["step"] == 0 else steps.row(decision["step"] - 1, named=True)
        distance = sum((decision[f"query_object_{axis}"] - before[f"object_{axis}"]) ** 2 for axis in "xyz") ** 0.5
        check(abs(page.number("#camera-caption", "data-distance") - distance) < 1e-6, f"{at}: {distance}")
        seen.add(page.run("return document.querySelector('#camera image').getAttribute('href')"))
    check(len(seen) == decisions.height, "two decisions have the same image")
    other = next((s for s in artifact.results["seed"].to_list() if s != seed), None)
    Select(page.one("#pick-seed")).select_by_visible_text(str(other))
    page.scrub(0)
    check(page.run("return document.getElementById('camera').hidden"), "a rollout without images shows one")


def timeline_shows_the_demonstrations(page, artifact):
    """The timeline has one band with a name for each run of steps with the same demonstration."""
    for seed in artifact.results["seed"].to_list():
        Select(page.one("#pick-seed")).select_by_visible_text(str(seed))
        steps, decisions = artifact.of(seed)
        demos = [decisions["demo_name"][number] for number in steps["decision"]]
        runs = [demo for i, demo in enumerate(demos) if i == 0 or demos[i - 1] != demo]
        titles = page.run("return [...document.querySelectorAll('#timeline .demo title')].map(title => title.textContent)")
        equal(len(titles), len(runs), f"seed {seed}, bands")
        for title, demo in zip(titles, runs):
            words = "return to the initial pose" if demo is None else f"{demo},"
            check(title.startswith(words), f"seed {seed}: {title!r} is not {words!r}")
        equal(len(page.all("#timeline .decision")), decisions.height, f"seed {seed}, decision marks")


def chunks_begin_at_the_set_point(page, artifact):
    """In transit, the reframed demonstration begins at the set-point of the end effector."""
    for decision in artifact.decisions.iter_rows(named=True):
        if decision["demo"] is None or decision["mode"] != "transit" or decision["kind"] != "retrieve":
            continue
        Select(page.one("#pick-seed")).select_by_visible_text(str(decision["seed"]))
        page.scrub(decision["step"])
        numbers = lambda layer: [float(v) for v in page.one(f"#scene .{layer}").get_attribute("d")[1:].replace("a", "L").split("L")[0].split()]
        (x, y), (ring, middle) = numbers("chunk"), numbers("set-point")
        check(abs(x - ring - 5) < 0.05 and abs(y - middle) < 0.05, f"the chunk begins at {x}, {y}, not at the set point")
        return
    check(False, "there is no decision in transit")


def addresses_open_a_step(page, path, artifact):
    seed = artifact.results["seed"][1]
    page.driver.get(f"{path.resolve().as_uri()}#seed={seed}&step=7")
    page.driver.refresh()
    browser.wait(page.driver, lambda: page.all("html[data-ready]"))
    check(f"seed {seed} " in page.one("#scene-caption").text, "the address does not open its seed")
    equal(page.step(), 7, "step of the address")
    page.press(Keys.ARROW_RIGHT)
    key = artifact.manifest["key"][:16]
    browser.wait(page.driver, lambda: page.driver.current_url.endswith(f"#rollout={key}/{seed}/8"))


def main():
    path, *folders = map(Path, sys.argv[1:])
    artifacts = [Artifact(folder) for folder in folders]
    with tempfile.TemporaryDirectory(prefix="re4-chromium-", ignore_cleanup_errors=True) as profile:
        page = Page(path, profile)
        try:
            rates_match_the_manifest(page, artifacts)
            cells_and_rows_follow_the_filter(page, artifacts)
            cells_can_be_navigated(page, artifacts[0])
            steps_show_the_tables(page, artifacts[0])
            timeline_shows_the_demonstrations(page, artifacts[0])
            chunks_begin_at_the_set_point(page, artifacts[0])
            images_belong_to_decisions(page, artifacts[0])
            # A low speed, because the rollouts are short.
            playback_works(page, "0.5")
            page_fits_widths_and_schemes(page)
            addresses_open_a_step(page, path, artifacts[0])
            no_files_were_loaded(page)
        finally:
            page.driver.quit()
    print(f"{path.name}: the page matches {len(artifacts)} artifacts")


if __name__ == "__main__":
    main()
