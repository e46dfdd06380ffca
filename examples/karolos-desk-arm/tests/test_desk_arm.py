"""Tests of `desk_arm`: its entry point and the promises of every robot with every task."""

from __future__ import annotations

from karolos.plugins.contracts import check
from karolos.registry import find


def test_it_is_found_by_its_entry_point() -> None:
    assert find("robots", "desk_arm").distribution == "karolos-desk-arm"


def test_it_keeps_what_every_robot_promises() -> None:
    check("robots", "desk_arm")
