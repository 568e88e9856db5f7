# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Values, lists and tables as HTML."""

from __future__ import annotations

from collections.abc import Sequence

from finger_model.laws import ParameterSpace

from ..report_units import MM4, interval_text, minus, three_digits

LONG_TABLE = 12
"""Rows beyond which a table may go on on the next page of a print."""


def table(header: Sequence[str], rows: Sequence[Sequence[str]], text: Sequence[int] = ()) -> str:
    """A table of HTML cells; `text` gives the columns that are aligned to the left."""

    def cells(kind: str, row: Sequence[str]) -> str:
        # A heading without a word is none, for those who hear the page.
        tags = [kind if cell else "td" for cell in row]
        return "".join(
            f"<{tag}{' class=text' if k in text else ''}>{cell}</{tag}>"
            for k, (tag, cell) in enumerate(zip(tags, row))
        )

    body = "".join(f"<tr>{cells('td', row)}</tr>" for row in rows)
    kind = " class=long" if len(rows) > LONG_TABLE else ""
    # Focusable, so that a keyboard can scroll it where the window is narrow.
    return (
        f"<div class=scroll tabindex=0><table{kind}><thead><tr>{cells('th', header)}</tr></thead>"
        f"<tbody>{body}</tbody></table></div>"
    )


def listing(items: Sequence[str]) -> str:
    """A list of HTML items; nothing without any."""
    return f"<ul>{''.join(f'<li>{item}</li>' for item in items)}</ul>" if items else ""


def headings(space: ParameterSpace, names: Sequence[str]) -> list[str]:
    """Symbols and units of quantities."""
    quantities = [space.describe(name) for name in names]
    return [f"{q.html} ({q.display_unit})" if q.display_unit else q.html for q in quantities]


def show(space: ParameterSpace, name: str, value: float) -> str:
    """A value (SI) in the quantity's display unit."""
    return minus(space.describe(name).text(value))


def area_cost(cost: float) -> str:
    """J (m⁴) in mm⁴."""
    return minus(three_digits(cost * MM4))


def span(
    space: ParameterSpace,
    name: str,
    ends: tuple[float, float],
    cut: Sequence[bool] = (False, False),
) -> str:
    """Both ends (SI) of an interval in the quantity's display unit, marked where `cut`."""
    return interval_text((show(space, name, end) for end in ends), cut, " – ")
