"""Every figure, table and equation of the paper, in its order, and what here answers it (`items.toml`).

An item that states a result is answered by claims of experiments, which name it; one that states a model, a method or a
scene by the module that has it and the test that holds it.
"""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import NamedTuple


class Item(NamedTuple):
    """One item of the paper."""

    title: str  # what it shows or says
    here: str = ""  # what is here in its place; "" where experiments answer
    module: str = ""  # file that has it
    test: str = ""  # test that holds it, file::function


_TEXT = Path(__file__).with_suffix(".toml").read_text("utf-8")
ITEMS = {key: Item(**item) for key, item in tomllib.loads(_TEXT).items()}
