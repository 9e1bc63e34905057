"""Headless Chromium with a page, controlled by the DevTools protocol. Needs the Python package websocket-client."""

import base64
import json
import shutil
import subprocess
import time
import urllib.request
from pathlib import Path

import websocket

PATIENCE_S = 60.0
# Keys with a name: virtual key code, and the text that the key types.
KEYS = {
    "Tab": (9, ""), "Enter": (13, "\r"), "Escape": (27, ""), " ": (32, " "), "PageUp": (33, ""), "PageDown": (34, ""), "End": (35, ""), "Home": (36, ""),
    "ArrowLeft": (37, ""), "ArrowUp": (38, ""), "ArrowRight": (39, ""), "ArrowDown": (40, ""), ".": (190, "."), "+": (187, "+"), "-": (189, "-"),
}
ALT, CONTROL, META, SHIFT = 1, 2, 4, 8


class Browser:
    def __init__(self, folder):
        program = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))))
        self.process = subprocess.Popen(
            [program, "--headless=new", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage",
             "--no-first-run", "--remote-debugging-port=0", "--remote-allow-origins=*",
             f"--user-data-dir={folder}", "about:blank"],
            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )
        ports = Path(folder) / "DevToolsActivePort"
        self.until(lambda: ports.exists() and len(ports.read_text().split()) == 2, "Chromium starts")
        port = ports.read_text().split()[0]
        pages = lambda: json.load(urllib.request.urlopen(f"http://127.0.0.1:{port}/json/list"))
        self.until(lambda: any(page["type"] == "page" for page in pages()), "a page opens")
        address = next(page for page in pages() if page["type"] == "page")["webSocketDebuggerUrl"]
        self.socket = websocket.create_connection(address, timeout=PATIENCE_S)
        self.number, self.events = 0, []
        # Numbers of the calls without an answer.
        self.open_calls = set()
        for domain in ("Page", "Runtime", "Log", "Network"):
            self.call(f"{domain}.enable")

    @staticmethod
    def until(holds, what):
        end = time.monotonic() + PATIENCE_S
        while not holds():
            assert time.monotonic() < end, f"{what}: not within {PATIENCE_S} s"
            time.sleep(0.02)

    def post(self, method, session=None, **parameters):
        """Sends a call without waiting for the answer; gives its number. `session`: of a Worker."""
        self.number += 1
        to = {"sessionId": session} if session else {}
        self.socket.send(json.dumps({"id": self.number, "method": method, "params": parameters, **to}))
        self.open_calls.add(self.number)
        return self.number

    def receive(self):
        message = json.loads(self.socket.recv())
        self.open_calls.discard(message.get("id"))
        return message

    def call(self, method, session=None, **parameters):
        number = self.post(method, session, **parameters)
        while True:
            message = self.receive()
            if message.get("id") == number:
                assert "error" not in message, (method, message["error"])
                return message["result"]
            self.events.append(message)

    def settle(self):
        """Waits for the answers of all calls."""
        while self.open_calls:
            self.events.append(self.receive())

    def value(self, expression):
        answer = self.call("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in answer, (expression, answer["exceptionDetails"])
        return answer["result"].get("value")

    def in_worker(self, expression):
        """Value of an expression in the Worker of the page."""
        self.call("Target.setAutoAttach", autoAttach=True, waitForDebuggerOnStart=False, flatten=True)
        workers = [event["params"] for event in self.events if event.get("method") == "Target.attachedToTarget"]
        session = next(one["sessionId"] for one in reversed(workers) if one["targetInfo"]["type"] == "worker")
        answer = self.call("Runtime.evaluate", session, expression=expression, returnByValue=True)
        self.call("Target.setAutoAttach", autoAttach=False, waitForDebuggerOnStart=False, flatten=True)
        assert "exceptionDetails" not in answer, (expression, answer["exceptionDetails"])
        return answer["result"].get("value")

    def emulate(self, width, height, mobile=False, scheme="light", motion="no-preference"):
        self.call("Emulation.setDeviceMetricsOverride", width=width, height=height,
                  deviceScaleFactor=2 if mobile else 1, mobile=mobile)
        self.call("Emulation.setTouchEmulationEnabled", enabled=mobile, maxTouchPoints=2)
        self.call("Emulation.setEmulatedMedia", features=[
            {"name": "prefers-color-scheme", "value": scheme}, {"name": "prefers-reduced-motion", "value": motion}])

    def open(self, path, ready, fragment=""):
        """Loads a file; the expression `ready` is true when the page can be used."""
        self.events.clear()
        # A change of the fragment alone loads nothing.
        self.call("Page.navigate", url="about:blank")
        self.call("Page.navigate", url=Path(path).resolve().as_uri() + fragment)
        self.until(lambda: self.value(f"document.readyState === 'complete' && location.protocol === 'file:' && !!({ready})"), "the page loads")

    def requests(self):
        """Addresses that the page has requested, itself included. Data and Blobs are in the page."""
        self.value("0")
        found = [event["params"]["request"]["url"] for event in self.events if event.get("method") == "Network.requestWillBeSent"]
        return [address for address in found if not address.startswith(("data:", "blob:", "about:"))]

    def wrong(self):
        """Exceptions, console errors and warnings, and requests other than files."""
        found = [address for address in self.requests() if not address.startswith("file:")]
        for event in self.events:
            method, content = event.get("method"), event.get("params", {})
            if method == "Runtime.exceptionThrown":
                found.append(content["exceptionDetails"])
            elif method == "Runtime.consoleAPICalled" and content["type"] in ("error", "warning", "assert"):
                found.append(content["args"])
            elif method == "Log.entryAdded" and content["entry"]["source"] == "rendering":
                pass  # Warning that reading pixels is slow, caused by the tests.
            elif method == "Log.entryAdded" and content["entry"]["level"] in ("error", "warning"):
                found.append(content["entry"])
        return found

    def screenshot(self, path, whole):
        shot = self.call("Page.captureScreenshot", format="png", captureBeyondViewport=whole)
        Path(path).write_bytes(base64.b64decode(shot["data"]))

    def mouse(self, kind, x, y, buttons=1, clicks=1, **more):
        """`kind`: Pressed, Moved, Released or Wheel (with deltaX and deltaY)."""
        button = "none" if kind in ("Moved", "Wheel") else "left"
        self.call("Input.dispatchMouseEvent", type=f"mouse{kind}", x=x, y=y, button=button, buttons=buttons, clickCount=clicks, **more)

    def click(self, x, y, clicks=1):
        self.mouse("Pressed", x, y, clicks=clicks)
        self.mouse("Released", x, y, buttons=0, clicks=clicks)

    def drag(self, points):
        """Draws with the button held down."""
        self.mouse("Pressed", *points[0])
        for point in points[1:]:
            self.mouse("Moved", *point)
        self.mouse("Released", *points[-1], buttons=0)

    def touch(self, kind, *points):
        """`kind`: Start, Move, End or Cancel; `points`: all fingers that touch."""
        self.call("Input.dispatchTouchEvent", type=f"touch{kind}", touchPoints=[{"x": x, "y": y, "id": n} for n, (x, y) in enumerate(points)])

    @staticmethod
    def key_event(name, modifiers=0):
        if name in KEYS:
            code, text = KEYS[name]
        else:
            code, text = ord(name.upper()), name
        event = {"key": name, "windowsVirtualKeyCode": code, "modifiers": modifiers}
        return event, {**event, "text": text} if text and not modifiers & (CONTROL | ALT | META) else event

    def key_down(self, name, modifiers=0):
        event = self.key_event(name, modifiers)[1]
        self.call("Input.dispatchKeyEvent", type="keyDown" if "text" in event else "rawKeyDown", **event)

    def key_up(self, name, modifiers=0):
        self.call("Input.dispatchKeyEvent", type="keyUp", **self.key_event(name, modifiers)[0])

    def key(self, name, modifiers=0, times=1):
        for _ in range(times):
            self.key_down(name, modifiers)
            self.key_up(name, modifiers)

    def close(self):
        self.socket.close()
        self.process.terminate()
        self.process.wait(timeout=PATIENCE_S)
