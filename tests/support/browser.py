"""Pages in a headless Chromium, of which a script tells what it finds."""

import json
import os
import re
import shutil
import subprocess
from html import escape, unescape

import pytest

NAMES = ("chromium", "chromium-browser", "google-chrome", "chrome")


def browser():
    """The program that FEATHERSTONE_GAIT_BROWSER names, or the first that is installed."""
    found = os.environ.get("FEATHERSTONE_GAIT_BROWSER") or next(filter(None, map(shutil.which, NAMES)), None)
    if found is None:
        pytest.skip("Chromium is no Python package and is not found here; .ci/run installs it for these tests")
    return found


def found_in(page, script, folder, *flags, sizes=((1280, 720),)):
    """What `script`, the body of a function, returns in the page in frames of these sizes; also of a promise.

    Also what the console was told, which is nothing if all is well.
    """
    told = (
        "<script>(async () => { try { parent.postMessage(JSON.stringify(await (() => {" + script + "})()), '*'); }"
        " catch (error) { parent.postMessage(JSON.stringify('error: ' + error.stack), '*'); } })();</script></body>"
    )
    inner = page.replace("</body>", told)
    frames = "".join(
        f'<iframe srcdoc="{escape(inner)}" style="border:0;width:{w}px;height:{h}px"></iframe>' for w, h in sizes
    )
    outer = folder / "frames.html"
    outer.write_text(
        "<!DOCTYPE html><html><body><pre id='found'></pre><script>const heard = [];"
        "const of = source => [...document.querySelectorAll('iframe')].findIndex(f => f.contentWindow === source);"
        "onmessage = e => { heard[of(e.source)] = JSON.parse(e.data);"
        "document.getElementById('found').textContent = JSON.stringify(heard); };</script>" + frames + "</body></html>",
        "utf-8",
    )
    command = [
        browser(), "--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars", "--window-size=1400,2400",
        f"--user-data-dir={folder / 'profile'}", "--virtual-time-budget=2000", "--enable-logging=stderr", *flags,
        "--dump-dom", outer.as_uri(),
    ]  # fmt: skip
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=True)
    found = re.search(r"<pre id=[\"']found[\"']>(.*?)</pre>", done.stdout, re.DOTALL)[1]
    console = [line for line in done.stderr.splitlines() if "CONSOLE" in line]
    return json.loads(unescape(found)), console
