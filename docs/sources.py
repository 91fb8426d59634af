"""Makes links to tests plain names on the site, which holds documents alone."""

import re
from typing import Any

_SOURCE = re.compile(r"\[([^\]]+)\]\((?:\.\./)+tests/[^)]+\)")


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Take the links to tests out of a page."""
    return _SOURCE.sub(r"\1", markdown)
