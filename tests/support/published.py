"""Robots of others, of packages too large for the test extra: `.ci/run` installs them and lets no test do without."""

import importlib.util
import os
from importlib import metadata
from pathlib import Path

import pytest


def folder(package):
    """Where the robots of a package are; skips the test where it is not installed."""
    if package == "example-robot-data":  # has no module to import
        try:
            found = metadata.distribution(package)
        except metadata.PackageNotFoundError:
            return missing(package)
        return Path(str(found.locate_file("cmeel.prefix/share/example-robot-data/robots")))
    spec = importlib.util.find_spec(package)
    return Path(spec.submodule_search_locations[0]) if spec else missing(package)


def missing(package):
    """Skip the test, or fail it where PUBLISHED_ROBOTS asks for all packages."""
    if "PUBLISHED_ROBOTS" in os.environ:
        pytest.fail(f"{package} is not installed, and PUBLISHED_ROBOTS asks for it")
    pytest.skip(f"{package} is too large for the test extra; .ci/run installs it and runs this")
