"""Make the pictures of docs/index.md and docs/gallery.md: `python docs/images/gallery.py [NAME ...]`.

Each program of these pages writes a page by `show`.  A headless Chromium draws its frames, which become an
animated WebP.
"""

import base64
import io
import json
import os
import re
import subprocess
import sys
import tempfile
from html import unescape
from pathlib import Path

from PIL import Image

HERE = Path(__file__).resolve().parent
PROGRAM = re.compile(r"^```python\n(.*?)^```$", re.MULTILINE | re.DOTALL)
WIDTH, HEIGHT, RATE, QUALITY = 400, 280, 12.5, 60  # [pixel], frames a second, of WebP
# Speed, first and last time [s]; of the camera the width that it shows, where it looks [m], yaw and pitch [rad].
VIEWS = {
    "kick": (0.5, 0.0, 1.3, 0.95, (0.25, -0.03, 0.13), (-1.1, 0.3)),  # of the first page
    "walk": (1.0, 0.4, 4.0, 0.75, (0.22, 0.0, 0.17), (-1.1, 0.3)),
    "push": (1.0, 0.6, 4.0, 0.75, (0.22, 0.0, 0.17), (-1.1, 0.3)),
    "dominoes": (0.5, 0.0, 1.5, 1.1, (0.3, 0.0, 0.1), (-1.1, 0.3)),
    "crank": (1.0, 0.0, 3.0, 0.6, (0.2, 0.0, 0.0), (-1.3, 0.2)),
    "balancer": (1.0, 0.8, 5.0, 1.1, (0.42, 0.0, 0.08), (-1.1, 0.3)),
    "omni": (1.0, 0.0, 6.0, 1.3, (0.45, 0.0, 0.0), (-1.1, 0.5)),
    "line": (8.0, 0.0, 42.0, 1.7, (0.0, 0.0, 0.0), (-1.3, 0.8)),
    "afloat": (1.0, 0.0, 4.0, 1.8, (0.15, 0.0, 0.0), (-1.1, 0.15)),
    "basket": (0.5, 0.0, 1.3, 4.2, (1.6, 0.0, 2.0), (-1.2, 0.25)),
    "belt": (2.0, 0.0, 8.0, 1.5, (0.0, 0.1, 0.22), (-1.1, 0.5)),
}
SCRIPT = """<pre id="frames"></pre><script>
{ const asked = %s, { view, go, show } = window.viewer, canvas = document.querySelector("canvas"), frames = [];
document.querySelector("#controls").hidden = true;
canvas.style.width = "%dpx"; canvas.style.height = "%dpx";
Object.assign(view, asked.view);
view.pan = asked.middle.map((x, k) => x - window.viewer.data.runs[0].middle[k]);
window.viewer.shown.follow = false; window.viewer.shown.prints = asked.prints;
for (const t of asked.times) { go(t); show(); frames.push(canvas.toDataURL("image/png")); }
document.getElementById("frames").textContent = JSON.stringify(frames); }
</script></body>"""


def programs() -> dict[str, str]:
    """Return the programs of the first page and the gallery by the names of the pages that they write."""
    text = "".join((HERE.parent / page).read_text("utf-8") for page in ("index.md", "gallery.md"))
    return {re.search(r'path="(\w+)\.html"', code)[1]: code for code in PROGRAM.findall(text)}


def frames(page: str, name: str, folder: Path) -> list[Image.Image]:
    """Let Chromium draw a page at the times of its picture."""
    speed, begin, end, span, middle, (yaw, pitch) = VIEWS[name]
    times = [begin + k * speed / RATE for k in range(1 + round((end - begin) * RATE / speed))]
    prints = name in ("walk", "push")
    view = {"span": span, "low": 1.0, "yaw": yaw, "pitch": pitch}
    asked = {"times": times, "prints": prints, "middle": middle, "view": view}
    (folder / "frames.html").write_text(page.replace("</body>", SCRIPT % (json.dumps(asked), WIDTH, HEIGHT)), "utf-8")
    command = ["chromium", "--headless", "--no-sandbox", "--disable-gpu", "--window-size=700,900",
               f"--user-data-dir={folder / 'profile'}", "--virtual-time-budget=3000", "--dump-dom",
               (folder / "frames.html").as_uri()]  # fmt: skip
    dom = subprocess.run(command, capture_output=True, text=True, timeout=300, check=True).stdout
    urls = json.loads(unescape(re.search(r'<pre id="frames">(.*?)</pre>', dom, re.DOTALL)[1]))
    return [Image.open(io.BytesIO(base64.b64decode(url.partition(",")[2]))).convert("RGB") for url in urls]


def save(pictures: list[Image.Image], path: Path) -> None:
    """Write an animated WebP."""
    first, *others = pictures
    first.save(path, save_all=True, append_images=others, duration=round(1e3 / RATE), loop=0, quality=QUALITY, method=6)


def main(names: list[str]) -> None:
    found = programs()
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        for name in names or found:
            exec(compile(found[name], name, "exec"), {})
            pictures = frames(Path(f"{name}.html").read_text("utf-8"), name, Path(folder))
            save(pictures, HERE / "gallery" / f"{name}.webp")
            print(name, len(pictures), "frames", (HERE / "gallery" / f"{name}.webp").stat().st_size, "bytes")


if __name__ == "__main__":
    main(sys.argv[1:])
