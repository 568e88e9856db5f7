# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Names of the conditions of a session: which can be run, and which may be misspelt."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from finger_common.condition_name import SESSION_NAME, SPELLING_ALONE, same_but_for_spelling
from finger_common.errors import nearest
from finger_common.guided_pulls import skin_of


def conditions_problem(names: Sequence[object]) -> str:
    """Why a session cannot have these conditions; empty when it can."""
    if not names:
        return "no condition is given; name at least one, such as natural"
    texts = []
    for name in names:
        if not isinstance(name, str) or not SESSION_NAME.fullmatch(name):
            return (
                f"condition '{str(name)[:40]}' is not valid in a session; use at most 64 letters, "
                "digits, - and _, and commas between conditions"
            )
        texts.append(name)
    if twins := same_but_for_spelling(texts):
        return f"conditions '{twins[0]}' and '{twins[1]}' {SPELLING_ALONE}"
    unique = len(set(texts)) == len(texts)
    return "" if unique else "a condition is named twice; give each block once"


def new_conditions(names: Iterable[str], known: Iterable[str]) -> str:
    """A sentence or two on each condition that is new and may be misspelt; empty without one.

    known: conditions with a preparation text, or of earlier sessions; so are their pulls.
    """
    skins = [skin_of(name) for name in known]
    folded = {skin.casefold(): skin for skin in skins}
    sentences = []
    for name in names:
        skin = skin_of(name)
        if not SESSION_NAME.fullmatch(name) or skin in skins:
            continue
        sentences.append(f"'{name}' is a new condition without a preparation text.")
        if near := nearest(skin.casefold(), folded):
            sentences.append(f"Write {folded[near]}{name[len(skin) :]} if that is meant.")
    return " ".join(sentences)
