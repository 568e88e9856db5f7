"""Tables that scripts write into the pages of docs/."""

from __future__ import annotations


def replace_between(text: str, name: str, content: str) -> str:
    """Text with what stands between the markers `name` replaced."""
    begin, end = f"<!-- {name} -->", f"<!-- /{name} -->"
    before, rest = text.split(begin, 1)
    after = rest.split(end, 1)[1]
    return f"{before}{begin}\n{content}\n{end}{after}"
