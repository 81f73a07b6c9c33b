"""Headless Chromium for the tests of the pages: needs selenium, and Debian's chromium and chromium-driver.

Time limits are generous: the tests check that an event happens, not how fast it does on a busy machine.
"""

import os
import sys
import tempfile

from selenium import webdriver
from selenium.common.exceptions import WebDriverException
from selenium.webdriver.chrome.options import Options
from selenium.webdriver.chrome.service import Service
from selenium.webdriver.support.ui import WebDriverWait

CHROMIUM = os.environ.get("RE4_CHROMIUM", "/usr/bin/chromium")
CHROMEDRIVER = os.environ.get("RE4_CHROMEDRIVER", "/usr/bin/chromedriver")

# Time limit for any event on a page, in seconds.
LONGEST = 300
# Number of attempts to start a browser: on a busy machine, it may not respond within the driver's time limit.
STARTS = 4


def start(profile):
    """Starts a browser with its own folders below `profile`."""
    for left in reversed(range(STARTS)):
        options = Options()
        options.binary_location = CHROMIUM
        # Shared memory is taken from the temporary folder, because containers may have little.
        for argument in ["--headless", "--no-sandbox", "--disable-gpu", "--no-first-run", "--disable-background-networking",
                         "--disable-component-update", "--disable-sync", "--disable-dev-shm-usage",
                         f"--user-data-dir={tempfile.mkdtemp(dir=profile)}"]:
            options.add_argument(argument)
        options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
        try:
            driver = webdriver.Chrome(options=options, service=Service(CHROMEDRIVER))
        except WebDriverException as error:
            print(f"the browser did not start, {left} tries left: {error}", file=sys.stderr)
            if left == 0:
                raise
            continue
        driver.set_script_timeout(LONGEST)
        driver.set_page_load_timeout(LONGEST)
        return driver


def wait(driver, until):
    """Waits until `until` returns a true value, and returns it."""
    return WebDriverWait(driver, LONGEST).until(lambda _: until())
