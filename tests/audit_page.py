"""Checks the page of an audit in headless Chromium against the data from which it was made.

    python tests/audit_page.py PAGE.html EXPECTED.json [--many]

EXPECTED.json contains the figures that the page has to show: frames by mode, findings by severity and by code, grasps by outcome,
values at the third frame, and for every demonstration its number, name, frames and counts. With --many, the page has hundreds of
demonstrations, and the frame times of scrolling through all of them are measured. Needs selenium, and Debian's chromium and
chromium-driver. Exits with code 1 and a sentence about the first difference.
"""

import json
import sys
import tempfile
from pathlib import Path
from urllib.parse import quote, unquote

import browser
from selenium.webdriver.common.by import By
from selenium.webdriver.common.keys import Keys
from selenium.webdriver.support.ui import Select

SEVERITIES = ["error", "warning", "note"]

# Scrolls from top to bottom, one step per screen frame, and records the times and the numbers of rendered rows. At the bottom it
# waits for the last rows.
SCROLL = """
const [rows, done] = arguments;
const host = document.getElementById("timeline-rows");
const long = [];
const observer = new PerformanceObserver((list) => long.push(...list.getEntries().map((entry) => entry.duration)));
observer.observe({ type: "longtask" });
const times = [], drawn = [];
host.scrollTop = 0;
const bottom = host.scrollHeight - host.clientHeight;
const steps = 240;
let step = 0, last;
const tick = (now) => {
  if (last !== undefined) times.push(now - last);
  last = now;
  drawn.push(Number(host.dataset.drawn));
  step += 1;
  host.scrollTop = bottom * step / steps;
  const bottom_row = Number(host.dataset.first) + Number(host.dataset.drawn);
  if (step <= steps + 2 || (bottom_row < rows && step < 100 * steps)) requestAnimationFrame(tick);
  else done({ times, drawn, long, height: host.clientHeight, last: bottom_row });
};
requestAnimationFrame(tick);
"""


def check(condition, message):
    if not condition:
        sys.exit(message)


def equal(found, expected, what):
    check(found == expected, f"{what}: the page has {found!r}, expected {expected!r}")


class Page:
    """The page in a browser."""

    def __init__(self, path, profile):
        self.driver = browser.start(profile)
        self.address = path.resolve().as_uri()
        self.resize(1440)
        self.open()

    def open(self, place=""):
        self.driver.get("about:blank")
        self.driver.get(self.address + place)
        browser.wait(self.driver, lambda: self.all("html[data-ready]"))
        self.settle()

    def resize(self, width, dark=False, still=False):
        size = {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": False}
        self.driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
        features = [{"name": "prefers-color-scheme", "value": "dark" if dark else "light"},
                    {"name": "prefers-reduced-motion", "value": "reduce" if still else "no-preference"}]
        self.driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": features})
        scheme = "return innerWidth === arguments[0] && matchMedia('(prefers-color-scheme: dark)').matches === arguments[1]"
        browser.wait(self.driver, lambda: self.run(scheme, width, dark))

    def run(self, script, *arguments):
        return self.driver.execute_script(script, *arguments)

    def settle(self):
        """Waits until pending changes are rendered."""
        self.run("return new Promise(done => requestAnimationFrame(() => requestAnimationFrame(() => done())))")

    def one(self, selector):
        return self.driver.find_element(By.CSS_SELECTOR, selector)

    def all(self, selector):
        return self.driver.find_elements(By.CSS_SELECTOR, selector)

    def fact(self, name):
        return int(self.one(f"[data-fact={name}]").get_attribute("data-value"))

    def chosen(self):
        return int(self.one("#evidence").get_attribute("data-demo"))

    def shown(self):
        return int(self.one("#shown-count").get_attribute("data-shown"))

    def press(self, selector):
        self.run("arguments[0].click()", self.one(selector))
        self.settle()

    def rows(self):
        """Numbers of the demonstrations in the order of the rows, read with the keyboard."""
        rows = self.one("#timeline-rows")
        rows.send_keys(Keys.HOME)
        numbers = [self.chosen()]
        for _ in range(self.shown() - 1):
            rows.send_keys(Keys.ARROW_DOWN)
            numbers.append(self.chosen())
        return numbers

    def ends(self):
        """The first and the last row."""
        rows = self.one("#timeline-rows")
        rows.send_keys(Keys.HOME)
        first = self.chosen()
        rows.send_keys(Keys.END)
        return first, self.chosen()

    def image(self):
        """A hash of the image of the timelines."""
        return hash(self.run("return document.getElementById('timeline-canvas').toDataURL()"))


def figures_match_the_audit(page, expected):
    equal(page.fact("demos"), len(expected["demos"]), "demonstrations")
    for name in ["frames", "transit_frames", "transfer_frames"]:
        equal(page.fact(name), expected[name], name)
    for severity in SEVERITIES:
        found = int(page.one(f".severity[data-severity={severity}]").get_attribute("data-count"))
        equal(found, expected["severities"][severity], f"findings of severity {severity}")
        equal(page.one(f".severity[data-severity={severity}] b").text, str(found), f"{severity} in words")
    for code, (findings, episodes) in expected["codes"].items():
        if findings == 0:
            check(page.all(f"[data-silent={code}]"), f"the check {code}, which has no findings, is not listed")
            continue
        chip = page.one(f".chip[data-code={code}]")
        found = [int(chip.get_attribute(f"data-{name}")) for name in ["findings", "episodes"]]
        equal(found, [findings, episodes], f"findings and demonstrations of {code}")
        equal([chip.find_element(By.CSS_SELECTOR, tag).text for tag in ["b", "small"]], [str(findings), f"in {episodes}"], f"{code} in words")
    equal(len(page.all("#checks tr[data-check]")), len(expected["codes"]), "rows of the table of checks")
    for name, value in (expected.get("contacts") or {}).items():
        name = "both" if name == "contact_and_motion" else name
        equal(float(page.one(f"[data-contacts={name}]").get_attribute("data-value")), value, f"steps: {name}")


def demonstrations_show_their_evidence(page, expected):
    """Choosing a demonstration shows its figures, findings and evidence."""
    worst = sorted(expected["demos"], key=lambda d: [-d[s] for s in SEVERITIES] + [d["number"]])
    images = set()
    for demo in [*worst[:4], worst[-1]]:
        page.open(address(demo))
        equal(page.chosen(), demo["number"], "chosen demonstration")
        equal(page.one("#evidence-title").text, demo["name"], "title of the evidence")
        summary = page.one("#evidence-summary").text
        check(f"{demo['frames']} frame" in summary, f"{demo['name']}: {summary}")
        equal(len(page.all("#evidence-findings button")), sum(demo[s] for s in SEVERITIES), f"findings of {demo['name']}")
        for severity in SEVERITIES:
            equal(len(page.all(f"#evidence-findings .glyph.sev-{severity}")), demo[severity], f"{severity}s of {demo['name']}")
        equal(len(page.all("#segments tbody tr")), demo["segments"], f"segments of {demo['name']}")
        equal(page.one("#evidence-plots").get_attribute("data-end"), str(demo["frames"]), "frames in the plots")
        images.add(page.run("return document.getElementById('evidence-plots').innerHTML"))
        check(page.all(".panel .curve[d^=M]"), f"{demo['name']} has no curves")
    check(len(images) == len({demo["number"] for demo in [*worst[:4], worst[-1]]}), "two demonstrations look the same")


def orders_change_the_rows(page, expected):
    """Every order has the correct first and last row."""
    demos = expected["demos"]
    page.open()
    keys = {
        "worst": lambda d: [-d[s] for s in SEVERITIES],
        "number": lambda d: d["number"],
        "length": lambda d: d["frames"],
        "fraction": lambda d: d["transfer_frames"] / max(1, d["frames"]),
        "grasp": lambda d: float("inf") if d["grasp_frame"] is None else d["grasp_frame"],
    }
    for name, key in keys.items():
        Select(page.one("#sort")).select_by_value(name)
        order = [d["number"] for d in sorted(demos, key=lambda d: (key(d), d["number"]))]
        equal(page.ends(), (order[0], order[-1]), f"first and last row by {name}")
        page.press("#reverse")
        equal(page.ends(), (order[-1], order[0]), f"first and last row by {name}, reversed")
        page.press("#reverse")
    if len(demos) <= 40:
        Select(page.one("#sort")).select_by_value("length")
        equal(page.rows(), [d["number"] for d in sorted(demos, key=lambda d: (d["frames"], d["number"]))], "rows by length")
    Select(page.one("#sort")).select_by_value("worst")


def filters_change_the_rows(page, expected):
    page.open()
    equal(page.shown(), len(expected["demos"]), "rows without a filter")
    whole = page.image()
    for code, (findings, episodes) in expected["codes"].items():
        if findings == 0:
            continue
        page.press(f".chip[data-code={code}]")
        equal(page.shown(), episodes, f"rows with {code}")
        equal(page.one(f".chip[data-code={code}]").get_attribute("aria-pressed"), "true", f"the button of {code}")
        page.press(f".chip[data-code={code}]")
    for severity in SEVERITIES:
        episodes = sum(d[severity] > 0 for d in expected["demos"])
        if episodes == 0:
            continue
        page.press(f".severity[data-severity={severity}]")
        equal(page.shown(), episodes, f"rows with a finding of severity {severity}")
        page.press("#clear-filters")
    equal(page.shown(), len(expected["demos"]), "rows after all filters were removed")
    text = page.one("#filter-text")
    name = expected["demos"][-1]["name"]
    text.send_keys(name)
    page.settle()
    equal(page.shown(), sum(name in d["name"] for d in expected["demos"]), f"rows with {name}")
    text.send_keys("no such words")
    page.settle()
    equal(page.shown(), 0, "rows with words that do not occur")
    check(page.one("#no-rows").is_displayed(), "an empty list has no note")
    page.press("#clear-filters")
    page.settle()
    equal(page.image(), whole, "timelines after all filters were removed")
    page.press("input[name=scale][value=fraction]")
    lengths = {demo["frames"] for demo in expected["demos"]}
    check((page.image() != whole) == (len(lengths) > 1), "the scale has to change rows if and only if lengths differ")
    page.press("input[name=scale][value=frames]")


def findings_show_their_frames(page, expected):
    demo = max(expected["demos"], key=lambda d: sum(d[s] for s in SEVERITIES))
    page.open(address(demo))
    if not page.all("#evidence-findings button"):
        return
    for button in page.all("#evidence-findings button"):
        page.run("arguments[0].click()", button)
        page.settle()
        equal(button.get_attribute("aria-pressed"), "true", "the chosen finding")
        first, end = (int(page.one("#evidence-plots").get_attribute(f"data-{name}")) for name in ["first", "end"])
        words = button.find_element(By.CSS_SELECTOR, ".kind-line").text
        if "whole demonstration" in words:
            continue
        numbers = words.split("frame")[1].lstrip("s ").split(" ")[0].split("–")
        check(first <= int(numbers[0]) and int(numbers[-1]) < end, f"frames {first} to {end} are shown for a finding at {words}")
    page.run("arguments[0].focus()", page.one("#evidence-plots"))
    page.one("#evidence-plots").send_keys(Keys.ESCAPE)
    page.settle()
    equal(page.one("#evidence-plots").get_attribute("data-end"), str(demo["frames"]), "the whole length after Escape")


def crosshair_reads_values(page, expected):
    demo = expected["demos"][0]
    page.open(address(demo))
    plots = page.one("#evidence-plots")
    page.run("arguments[0].focus()", plots)
    plots.send_keys(Keys.ARROW_RIGHT, Keys.ARROW_RIGHT, Keys.ARROW_RIGHT)
    equal(page.one("#readout").get_attribute("data-frame"), "2", "frame after three times right")
    check("Frame 2 (" in page.one("#readout").text, "the words of the frame")
    for panel in expected["panels"]:
        values = page.run("return [...document.querySelectorAll(`.panel[data-panel='${arguments[0]}'] .number`)].map(e => e.dataset.value)", panel["title"])
        equal(len(values), len(panel["values"]), f"values of {panel['title']}")
        for found, stated in zip(values, panel["values"]):
            if stated is None:
                check(found in ("", "NaN"), f"{panel['title']}: {found} instead of no value")
            else:
                check(abs(float(found) - stated) <= 1e-6 * max(abs(stated), 1e-30), f"{panel['title']}: {found} is not {stated}")


def address(demo):
    """The fragment of a demonstration's address."""
    return f"#demo={quote(demo['name'])}"


def addresses_open_demonstrations(page, expected):
    by_number = {demo["number"]: demo for demo in expected["demos"]}
    first, last = expected["demos"][0], expected["demos"][-1]
    page.open(address(last) + "&frames=2-6")
    equal(page.chosen(), last["number"], "demonstration of the address")
    equal([page.one("#evidence-plots").get_attribute(f"data-{name}") for name in ["first", "end"]], ["2", "7"], "frames of the address")
    check(not page.one("#address-notice").is_displayed(), "there is a warning about a valid address")
    page.open(address(first))
    equal(page.chosen(), first["number"], "demonstration of another address")
    for dead, words in [("#demo=123456", "123456"), (address(last) + "&frames=5-999999", "999999"), ("#nowhere", "#nowhere")]:
        page.open(dead)
        page.run("return new Promise(done => setTimeout(done, 400))")
        notice = page.one("#address-notice")
        check(notice.is_displayed() and words in notice.text, f"there is no warning about the invalid address {dead}: {notice.text!r}")
        check(page.all("#evidence-plots .panel"), f"nothing is shown after the invalid address {dead}")
    page.one("#timeline-rows").send_keys(Keys.END)
    page.one("#timeline-rows").send_keys(Keys.HOME)
    check(not page.one("#address-notice").is_displayed(), "the warning is still shown after a choice")
    browser.wait(page.driver, lambda: page.driver.current_url.endswith(address(by_number[page.chosen()])))


def marks_can_be_clicked(page, expected):
    """A click on a row selects it, and a click on a grasp selects its demonstration."""
    page.open()
    rows = page.one("#timeline-rows")
    before = page.chosen()
    page.run("const b = arguments[0].getBoundingClientRect(); arguments[0].dispatchEvent(new MouseEvent('click',"
             "{clientX: b.left + 30, clientY: b.top + 18 + 9, bubbles: true}))", rows)
    page.settle()
    if len(expected["demos"]) > 1:
        check(page.chosen() != before, "a click on the second row does not select it")
    canvases = page.all("canvas.grasps")
    check(canvases or not expected["grasps"], "no plots of grasps")
    for canvas in canvases if expected["grasps"] is not None else []:
        equal(int(canvas.get_attribute("data-marks")), expected["grasps"], "marks of grasps")
    if canvases and len(expected["demos"]) > 1:
        page.run("arguments[0].focus()", canvases[0])
        seen = {page.chosen()}
        for _ in range(8):
            canvases[0].send_keys(Keys.ARROW_RIGHT)
            seen.add(page.chosen())
        check(len(seen) > 1, "arrow keys among the grasps select nothing")
    for outcome, count in expected["outcomes"].items():
        equal(page.one(f"#grasp-legend [data-outcome='{outcome}']").get_attribute("data-count"), str(count), f"grasps {outcome}")


def kept(page):
    return int(page.one("#keep-count").get_attribute("data-kept"))


def keep_list_can_be_edited(page, expected):
    """Buttons, the box and the text change the same list, and both files contain it."""
    page.open()
    usable = [demo["name"] for demo in expected["demos"] if demo["frames"] > 0]
    equal(kept(page), len(usable), "demonstrations on the keep-list at the start")
    value = lambda selector: page.run("return arguments[0].value", page.one(selector))
    page.press("#keep-this")
    dropped = page.one("#evidence-title").text
    equal(value("#keep-text").split("\n")[:-1], [name for name in usable if name != dropped], "names without the dropped one")
    setting = value("#keep-toml")
    for name in usable[:50]:
        number = name.removeprefix("episode ")
        entry = number if number != name else f'"{name}"'
        listed = entry in setting.split("[", 2)[2].rstrip("]} \n").split(", ")
        equal(listed, name != dropped, f"{name} in the setting")
    for link, text in [("#save-names", value("#keep-text")), ("#save-toml", setting)]:
        address = page.one(link).get_attribute("href")
        equal(unquote(address.split(",", 1)[1]), text, f"the file of {link}")
    code = next((code for code, (findings, _) in expected["codes"].items() if findings > 0), None)
    page.press("#keep-all")
    if code is not None:
        page.press(f".chip[data-code={code}]")
        listed = page.shown()
        page.press("#keep-listed")
        check(0 <= kept(page) <= listed, "more demonstrations are kept than listed")
        page.press("#drop-listed")
        equal(kept(page), 0, "demonstrations after those listed were dropped")
        page.press("#clear-filters")
    text = page.one("#keep-text")
    page.run("const e = arguments[0]; e.value = arguments[1]; e.dispatchEvent(new Event('input'))", text, f"{usable[0]}\nno such name\n")
    equal(kept(page), 1, "demonstrations after the text was edited")
    check(page.one("#keep-notice").is_displayed() and "no such name" in page.one("#keep-notice").text, "there is no warning about an unknown name")
    page.press("#keep-all")
    equal(kept(page), len(usable), "demonstrations after all are kept")


def scores_rank_demonstrations(page, expected):
    """The plot has one mark per demonstration, and the worst ones can be dropped."""
    if not page.all("#scores"):
        return
    page.open()
    usable = sum(demo["frames"] > 0 for demo in expected["demos"])
    marks = page.all("#score-plot circle")
    check(0 < len(marks) <= usable, f"{len(marks)} marks for {usable} demonstrations")
    page.run("arguments[0].dispatchEvent(new MouseEvent('click', {bubbles: true}))", marks[0])
    page.settle()
    equal(page.one("#evidence-title").text, page.one("#score-plot circle.chosen").get_attribute("data-demo"), "the demonstration of a mark")
    check("quality" in page.one("#evidence-scores").text, "the scores of the selected demonstration are not shown")
    page.run("arguments[0].value = 1", page.one("#drop-count"))
    page.press("#drop-worst")
    equal(kept(page), usable - 1, "demonstrations after the worst was dropped")
    equal(len(page.all("#score-plot circle.dropped")), 1, "hollow marks")
    Select(page.one("#sort")).select_by_value("score quality")
    worst, best = page.ends()
    check(usable < 2 or worst != best, "the order by quality has one end")
    Select(page.one("#sort")).select_by_value("worst")
    page.press("#keep-all")


def demonstrations_can_be_compared(page, expected):
    """Choosing another demonstration adds its curves."""
    page.open()
    options = [option.get_attribute("value") for option in page.all("#compare option") if option.get_attribute("value")]
    check(options or len(expected["demos"]) < 2, "there is nothing to compare with")
    if not options:
        return
    Select(page.one("#compare")).select_by_value(options[0])
    page.settle()
    check(page.all("#evidence-plots .curve.other"), "the other demonstration has no curves")
    Select(page.one("#compare")).select_by_value("")
    page.settle()
    check(not page.all("#evidence-plots .curve.other"), "the curves of the other demonstration remain")


def controls_have_names(page):
    names = page.run("return [...document.querySelectorAll('button, select, input, textarea, [tabindex=\"0\"]')].filter(e => !("
                     "e.ariaLabel || e.getAttribute('aria-label') || e.textContent.trim() || (e.labels && [...e.labels].some(l => l.textContent.trim()))"
                     ")).map(e => e.outerHTML)")
    check(not names, f"controls without a name: {names}")


def page_fits_widths_and_schemes(page):
    images = set()
    for width in [1440, 1024, 768, 380]:
        for dark in [False, True]:
            page.resize(width, dark, still=True)
            page.settle()
            page.settle()
            wide = page.run("return document.documentElement.scrollWidth")
            check(wide <= width, f"at {width} px the page is {wide} px wide")
            images.add(page.image())
    equal(len(images), 8, "different images in four widths and two schemes")
    page.resize(1440)
    page.settle()


def page_prints(page, expected):
    """All rows are printed, and afterwards the screen is as before."""
    page.open()
    drawn = page.run("window.dispatchEvent(new Event('beforeprint')); return document.getElementById('timeline-rows').dataset.drawn")
    equal(int(drawn), len(expected["demos"]), "rows on paper")
    page.run("window.dispatchEvent(new Event('afterprint'))")
    check(int(page.one("#timeline-rows").get_attribute("data-drawn")) <= 80, "rows after printing")
    check(len(page.driver.execute_cdp_cmd("Page.printToPDF", {})["data"]) > 10_000, "the printed page is empty")


def scrolling_renders_few_rows(page, expected):
    page.open()
    measured = page.driver.execute_async_script(SCROLL, len(expected["demos"]))
    times = sorted(measured["times"])
    at = lambda part: times[min(len(times) - 1, int(part * len(times)))]
    maximum = max(measured["drawn"])
    print(f"scrolling through {len(expected['demos'])} demonstrations: frames p50 {at(0.5):.1f} ms, p99 {at(0.99):.1f} ms, "
          f"at most {maximum} rows per frame, {len(measured['long'])} long tasks, longest {max(measured['long'], default=0):.0f} ms")
    equal(measured["last"], len(expected["demos"]), "row after the last one in view, at the bottom")
    check(maximum <= measured["height"] / 18 + 2, f"{maximum} rows are rendered in a frame")
    elements = page.run("return document.querySelectorAll('*').length")
    check(elements < 2500, f"the page has {elements} elements")


def no_files_were_loaded(page):
    entries = page.run("return performance.getEntriesByType('resource').map(entry => entry.name)")
    check(all(name.startswith("data:") for name in entries), f"the page loaded {entries}")
    log = page.driver.get_log("browser")
    check(not log, f"the browser's log: {log}")


def main():
    path, summary, *more = sys.argv[1:]
    expected = json.loads(Path(summary).read_text())
    with tempfile.TemporaryDirectory(prefix="re4-chromium-", ignore_cleanup_errors=True) as profile:
        page = Page(Path(path), profile)
        try:
            figures_match_the_audit(page, expected)
            demonstrations_show_their_evidence(page, expected)
            orders_change_the_rows(page, expected)
            filters_change_the_rows(page, expected)
            findings_show_their_frames(page, expected)
            crosshair_reads_values(page, expected)
            addresses_open_demonstrations(page, expected)
            marks_can_be_clicked(page, expected)
            keep_list_can_be_edited(page, expected)
            scores_rank_demonstrations(page, expected)
            demonstrations_can_be_compared(page, expected)
            controls_have_names(page)
            page_fits_widths_and_schemes(page)
            page_prints(page, expected)
            if "--many" in more:
                scrolling_renders_few_rows(page, expected)
            no_files_were_loaded(page)
        finally:
            page.driver.quit()
    print(f"{Path(path).name}: the page matches the audit of {len(expected['demos'])} demonstrations")


if __name__ == "__main__":
    main()
