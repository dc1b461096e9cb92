"""Pages in a headless Chromium, of which a script tells what it finds."""

import fcntl
import json
import os
import re
import shutil
import subprocess
import time
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
    """Run a script in a page, in one frame of each size; return its results and the lines of the console.

    script: the body of a function, which returns a value or a promise.  The console has no lines if all is well.
    """
    reporter = (
        "<script>(async () => { try { parent.postMessage(JSON.stringify(await (() => {" + script + "})()), '*'); }"
        " catch (error) { parent.postMessage(JSON.stringify('error: ' + error.stack), '*'); } })();</script></body>"
    )
    inner = page.replace("</body>", reporter)
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


class Tab:
    """A page in a headless Chromium that is steered while it runs, by the DevTools protocol over pipes."""

    def __init__(self, url, folder, size=(1280, 720), dark=False):
        (theirs_in, ours_out), (ours_in, theirs_out) = os.pipe(), os.pipe()

        def pipes():  # Chromium reads 3 and writes 4
            high = [fcntl.fcntl(end, fcntl.F_DUPFD, 10) for end in (theirs_in, theirs_out)]
            os.dup2(high[0], 3)
            os.dup2(high[1], 4)

        command = [
            browser(), "--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars", "--remote-debugging-pipe",
            f"--user-data-dir={folder / 'tab'}", "about:blank",
        ]  # fmt: skip
        quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
        self._process = subprocess.Popen(command, preexec_fn=pipes, close_fds=False, **quiet)
        os.close(theirs_in)
        os.close(theirs_out)
        self._out, self._in, self._rest = ours_out, ours_in, b""
        self._number, self._session, self.console = 0, {}, []
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        self._session = {"sessionId": self.call("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]}
        for domain in ("Runtime", "Page", "Log"):
            self.call(f"{domain}.enable")
        width, height = size
        self.call("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=False)
        if dark:
            self.call("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": "dark"}])
        self.call("Page.navigate", url=url)
        self.until("document.readyState === 'complete' && Boolean(window.viewer)")

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.call("Browser.close")
        self._process.wait(30)
        os.close(self._out)
        os.close(self._in)

    def call(self, method, **parameters):
        """Call a method of the protocol; return its result."""
        self._number += 1
        message = {"id": self._number, "method": method, "params": parameters} | self._session
        os.write(self._out, json.dumps(message).encode() + b"\0")
        while True:
            while b"\0" not in self._rest:
                more = os.read(self._in, 1 << 20)
                assert more, "Chromium has ended"
                self._rest += more
            one, self._rest = self._rest.split(b"\0", 1)
            answer = json.loads(one)
            if answer.get("id") == self._number:
                assert "error" not in answer, answer
                return answer["result"]
            if answer.get("method") in ("Runtime.exceptionThrown", "Log.entryAdded", "Runtime.consoleAPICalled"):
                self.console.append(answer["params"])

    def value(self, expression):
        """The value of an expression in the page."""
        answer = self.call("Runtime.evaluate", expression=expression, returnByValue=True)
        assert "exceptionDetails" not in answer, answer
        return answer["result"].get("value")

    def until(self, expression, patience=60.0):
        """Wait until an expression is true; return it."""
        end = time.monotonic() + patience
        while not (found := self.value(expression)):
            assert time.monotonic() < end, f"never true: {expression}"
            time.sleep(0.05)
        return found

    def mouse(self, kind, x, y):
        """Press, move or release the mouse."""
        how = {"button": "left", "buttons": int(kind != "Released"), "clickCount": 1}
        self.call("Input.dispatchMouseEvent", type=f"mouse{kind}", x=x, y=y, **how)

    def key(self, kind, key):
        """Press ("Down") or release ("Up") a key."""
        self.call("Input.dispatchKeyEvent", type=f"key{kind}", key=key, code=key)
