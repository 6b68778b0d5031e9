#!/bin/sh
# Sees that there is a Chromium, in which a test opens the robustness report, and where there is
# none installs one: as root, by apt.  browser.sh VENV
# Never fails: the test is skipped then.
set -u
venv=$1

for name in chromium chromium-browser google-chrome google-chrome-stable; do
    command -v "$name" >/dev/null && exit 0
done
"$venv/bin/python" - 2>/dev/null <<'END' && exit 0
import os, sys
from playwright.sync_api import sync_playwright
with sync_playwright() as playwright:
    sys.exit(not os.path.exists(playwright.chromium.executable_path))
END

skip() {
    echo "no Chromium, the report is not opened in a browser: $1"
    exit 0
}

[ "$(id -u)" = 0 ] && command -v apt-get >/dev/null ||
    skip "install one, or run .venv/bin/playwright install chromium"
echo "Installing Chromium for the test of the robustness report (BROWSER=no does without) ..."
export DEBIAN_FRONTEND=noninteractive
{ apt-get -qq update && apt-get -qq install -y --no-install-recommends chromium; } \
    >/dev/null 2>&1 || skip "apt-get install chromium failed"
