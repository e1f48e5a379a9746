"""A Chromium without a window for tests, spoken to through a pipe in its DevTools protocol."""

import base64
import itertools
import json
import os
import shutil
import subprocess
import sys

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
CHROMIUM = os.environ.get("CHROMIUM") or next(filter(None, map(shutil.which, NAMES)), None)
OFF = ("gpu", "quic", "sync", "background-networking", "component-update")
FLAGS = ["--headless", "--no-sandbox", "--no-first-run", "--remote-debugging-pipe"]
FLAGS += [f"--disable-{part}" for part in OFF]
_EXEC = """
import fcntl, os, sys
ends = [fcntl.fcntl(int(end), fcntl.F_DUPFD, 10) for end in sys.argv[1:3]]
for number, end in zip((3, 4), ends):  # where Chromium looks for the pipe
    os.dup2(end, number)
os.execv(sys.argv[3], sys.argv[3:])
"""


class Browser:
    """One page; what it complains of is in `wrong`."""

    def __init__(self, profile):
        """`profile` is a new empty folder."""
        theirs, to = os.pipe()
        back, ours = os.pipe()
        through = [sys.executable, "-c", _EXEC, str(theirs), str(ours)]
        arguments = [CHROMIUM, *FLAGS, f"--user-data-dir={profile}", "about:blank"]
        self._process = subprocess.Popen(
            [*through, *arguments],
            pass_fds=(theirs, ours),
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        os.close(theirs)
        os.close(ours)
        self._to, self._back = os.fdopen(to, "wb"), os.fdopen(back, "rb")
        self._numbers, self._session, self.wrong = itertools.count(1), None, []
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        attached = self.call("Target.attachToTarget", targetId=target, flatten=True)
        self._session = attached["sessionId"]
        for part in ("Runtime", "Log", "Page"):
            self.call(f"{part}.enable")

    def call(self, method, **params):
        """Send one command and wait for its answer."""
        number = next(self._numbers)
        message = {"id": number, "method": method, "params": params}
        if self._session:
            message["sessionId"] = self._session
        self._to.write(json.dumps(message).encode() + b"\0")
        self._to.flush()
        while True:
            answer = self._read()
            if answer.get("id") == number:
                assert "error" not in answer, answer
                return answer["result"]
            self._heed(answer)

    def run(self, program):
        """The value of an async function's body, run in the page."""
        result = self.call(
            "Runtime.evaluate",
            expression=f"(async () => {{ {program} }})()",
            awaitPromise=True,
            returnByValue=True,
        )
        assert "exceptionDetails" not in result, result["exceptionDetails"]
        return result["result"].get("value")

    def screen(self, width, height, dark=False):
        """As a screen of this size; a narrow one is a phone's."""
        size = {"width": width, "height": height, "deviceScaleFactor": 1}
        self.call("Emulation.setDeviceMetricsOverride", **size, mobile=width < 600)
        scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
        self.call("Emulation.setEmulatedMedia", features=[scheme])

    def picture(self, path):
        """A screenshot."""
        data = self.call("Page.captureScreenshot", format="png")["data"]
        path.write_bytes(base64.b64decode(data))

    def close(self):
        """End it."""
        self._to.close()
        self._back.close()
        self._process.terminate()
        self._process.wait()

    def _read(self):
        data = bytearray()
        while (byte := self._back.read(1)) != b"\0":
            assert byte, "the browser has ended"
            data += byte
        return json.loads(data)

    def _heed(self, event):
        method, params = event.get("method"), event.get("params", {})
        said = method == "Runtime.consoleAPICalled" and params["type"] in ("error", "warning")
        if said or method in ("Runtime.exceptionThrown", "Log.entryAdded"):
            self.wrong.append(params)
