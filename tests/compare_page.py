"""Checks the page of a comparison in headless Chromium against the artifact from which it was made.

    python tests/compare_page.py PAGE.html ARTIFACT

Needs selenium, polars, and Debian's chromium and chromium-driver. Exits with code 1 and a sentence about the first difference.
"""

import json
import sys
import tempfile
from pathlib import Path

import browser
import polars as pl
from selenium.webdriver.common.by import By


def check(condition, message):
    if not condition:
        sys.exit(message)


def equal(found, expected, what):
    check(found == expected, f"{what}: the page has {found!r}, the artifact {expected!r}")


class Page:
    """The page in a browser."""

    def __init__(self, path, profile):
        self.driver = browser.start(profile)
        self.resize(1280)
        self.driver.get(path.resolve().as_uri())

    def resize(self, width, dark=False):
        size = {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": False}
        self.driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
        scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
        self.driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": [scheme]})

    def run(self, script):
        return self.driver.execute_script(script)

    def one(self, selector):
        return self.driver.find_element(By.CSS_SELECTOR, selector)

    def all(self, selector):
        return self.driver.find_elements(By.CSS_SELECTOR, selector)


def cells_match(page, manifest, cells):
    for cell in manifest["config"]["cells"]:
        row, column = cell["row"], cell["column"]
        place = page.one(f"td[data-row='{row}'][data-column='{column}']")
        own = cells.filter((pl.col("row") == row) & (pl.col("column") == column))
        first = own.row(0, named=True)
        if first["error"]:
            check("cannot run" in place.text, f"{row}, {column} does not say that it cannot run")
        else:
            value = place.find_element(By.CSS_SELECTOR, ".value")
            for part in ["value", "low", "high"]:
                equal(float(value.get_attribute(f"data-{part}")), first[part], f"{part} of {row}, {column}")
            equal(value.text, f"{first['value']:.3f}", f"{row}, {column} in words")
        if first["printed"] is not None:
            printed = place.find_element(By.CSS_SELECTOR, ".printed")
            equal(float(printed.get_attribute("data-printed")), first["printed"], f"printed figure of {row}, {column}")
    equal(page.one("[data-fact=ran]").get_attribute("data-value"), str(manifest["summary"]["cells"] - manifest["summary"]["failed"]),
          "number of cells that ran")
    for sentence in cells["error"].drop_nulls().unique():
        check(sentence in page.one(".failures").text, f"the page does not show: {sentence}")


def differences_match(page, differences):
    equal(len(page.all("tr[data-difference]")), differences.height, "number of differences")
    for row in differences.iter_rows(named=True):
        place = page.one(f"tr[data-difference='{row['row']}'][data-column='{row['column']}'][data-measure='{row['measure']}']")
        equal(float(place.get_attribute("data-value")), row["difference"], f"difference of {row['row']}, {row['column']}")
        equal(float(place.get_attribute("data-p")), row["p"], f"p of {row['row']}, {row['column']}")


def curves_match(page, cells, curves):
    for (row, column), points in curves.group_by(["row", "column"]):
        measure = cells.filter((pl.col("row") == row) & (pl.col("column") == column))["measure"][0]
        points = points.filter(pl.col("measure") == measure).sort("budget")
        found = [label.get_attribute("textContent") for label in page.all(f"g[data-curve='{row}'] title")]
        for point in points.iter_rows(named=True):
            text = f"{row}, {point['budget']} steps: {point['value']:.3f} [{point['low']:.3f}, {point['high']:.3f}]"
            check(text in found, f"no point {text!r} among {found}")


def costs_are_recorded(page, manifest, artifact):
    runs = artifact.parent.parent / "runs"
    for cell in manifest["config"]["cells"]:
        if cell["error"]:
            continue
        key = manifest["inputs"][f"{cell['row']}, {cell['column']}"]
        record = json.loads((runs / f"rollout-{key[:16]}.json").read_text())
        row = page.one(f"tr[data-cost='{cell['row']}'][data-column='{cell['column']}']")
        text = row.text
        check("none" in text, f"a policy without training: {text}")
        time = record["actions"]["p50_us"]
        shown = f"{time:.1f} µs" if time < 100 else f"{time:.0f} µs" if time < 1e3 else f"{time / 1e3:.2f} ms"
        check(shown in text, f"{shown} is not in {text!r}")
        check(f" {record['threads']} " in text and "UTC" in text, f"threads or date are not in {text!r}")


def nothing_overflows(page):
    for width in [1280, 700, 390]:
        for dark in [False, True]:
            page.resize(width, dark)
            check(page.run("return document.documentElement.scrollWidth <= innerWidth"), f"the page overflows at {width} px")


def main():
    path, artifact = Path(sys.argv[1]), Path(sys.argv[2])
    manifest = json.loads((artifact / "manifest.json").read_text())
    tables = {name: pl.read_parquet(artifact / f"{name}.parquet") for name in ["cells", "differences", "curves"]}
    tables = {name: table.with_columns(pl.col(pl.Categorical).cast(pl.String)) for name, table in tables.items()}
    with tempfile.TemporaryDirectory() as profile:
        page = Page(path, profile)
        try:
            page.run("for (const details of document.querySelectorAll('details')) details.open = true")
            cells_match(page, manifest, tables["cells"])
            differences_match(page, tables["differences"])
            curves_match(page, tables["cells"], tables["curves"])
            costs_are_recorded(page, manifest, artifact)
            nothing_overflows(page)
            log = page.driver.get_log("browser")
            check(not log, f"the browser reports {log}")
        finally:
            page.driver.quit()


main()
