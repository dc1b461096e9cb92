"""Prepare the README and the addresses that a package index shows, when a wheel or source distribution is built.

An index has no files beside the README.  If CITATION.cff states `repository-code`, links and pictures of the README
lead there, and the index lists the project's addresses; else links become plain text, and what is nothing but pictures
and links is left out.
"""

import re
from pathlib import Path

from hatchling.metadata.plugin.interface import MetadataHookInterface

BESIDE = re.compile(r"(!?)\[([^\]]*)\]\((?!https?:)([^)#\s]+)(#[^)\s]*)?\)")  # a link or a picture, and its file
ASIDE = re.compile(r" \(\[[^\]]*\]\((?!https?:)[^)]*\)\)")  # a link in brackets of its own
ALONE = re.compile(r"^!\[[^\n]*\n\n|^## Where to go\n.*?(?=^## )", re.MULTILINE | re.DOTALL)
COMMENT = re.compile(r"^<!-- [^>]* -->\n|<!-- [^>]* -->", re.MULTILINE)  # markers of docs/tables.py
REPOSITORY = re.compile(r"""^repository-code: *["']?(https://[^"'\s]+)""", re.MULTILINE)


class Metadata(MetadataHookInterface):
    """Set the fields of pyproject.toml that are listed there as dynamic."""

    def update(self, metadata):
        root = Path(self.root)
        address = repository((root / "CITATION.cff").read_text("utf-8"))
        text = for_index((root / "README.md").read_text("utf-8"), address, metadata_version(root))
        metadata["readme"] = {"content-type": "text/markdown", "text": text}
        metadata["urls"] = addresses(address)


def metadata_version(root):
    """Return the tag of the version, under which the repository has the files that the README names."""
    text = (root / "featherstone_gait" / "__init__.py").read_text("utf-8")
    return "v" + re.search(r'^__version__ = "(.*)"$', text, re.MULTILINE)[1]


def repository(citation):
    """Return the address of the repository that CITATION.cff states, "" if it states none."""
    stated = REPOSITORY.search(citation)
    return stated[1].rstrip("/") if stated else ""


def addresses(address):
    """Return what an index lists beside the README."""
    paper = {"Paper": "https://doi.org/10.5772/54766"}
    if not address:
        return paper
    files = f"{address}/blob/main"
    return paper | {
        "Repository": address,
        "Issues": f"{address}/issues",
        "Documentation": f"{files}/docs/index.md",
        "Changelog": f"{files}/CHANGELOG.md",
    }


def for_index(readme, address, tag):
    """Return the README with links that lead somewhere without the files beside it."""

    def elsewhere(found):
        picture, text, path, anchor = found.groups(default="")
        if address:
            return f"{picture}[{text}]({address}/{'raw' if picture else 'blob'}/{tag}/{path}{anchor})"
        return "" if picture else text

    text = COMMENT.sub("", readme)
    return BESIDE.sub(elsewhere, text if address else ASIDE.sub("", ALONE.sub("", text)))
