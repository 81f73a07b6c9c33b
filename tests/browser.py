"""Headless Chromium for the tests of the pages: needs selenium, and Debian's chromium and chromium-driver.

What is waited for has to happen; how soon, on a busy machine, is not what the tests are about, so the limits are wide.
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

# Seconds that anything on a page may take.
LONGEST = 300
# Browsers that are started: on a busy machine one may not answer in the time that the driver gives it.
STARTS = 4


def start(profile):
    """A browser with folders of its own below `profile`."""
    for left in reversed(range(STARTS)):
        options = Options()
        options.binary_location = CHROMIUM
        # Shared memory from the temporary folder: containers may have little of their own.
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
    """Waits until `until` answers with something that holds."""
    return WebDriverWait(driver, LONGEST).until(lambda _: until())
