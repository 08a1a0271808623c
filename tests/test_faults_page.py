"""Every line of the guide's table of faults has tests, by name, and they are there."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

TESTS: dict[str, tuple[str, ...]] = {
    "controller killed": (
        "test_killed_controller_leaves_the_rig_up_in_its_safe_state_and_said",
        "test_stopped_controller_trips_the_watchdog_and_does_not_outlive_the_session",
        "test_controller_that_dies_is_followed_by_hold_then_the_latched_safe_state",
    ),
    "rig killed": ("test_killed_rig_ends_the_session_and_keeps_the_log",),
    "session killed": ("test_killed_session_leaves_no_orphan_and_a_log_whole_but_for_the_last_tenth",),
    "Ctrl-C": ("test_stop_ends_everything_and_closes_the_log", "test_all_are_asked_at_once_share_one_grace_and_are_killed"),
    "link cut": ("test_link_down_for_a_second_trips_the_watchdog_whose_safe_state_stays",
                 "test_a_cut_cable_is_survived_and_both_ends_meet_again"),
    "disk full": ("test_full_disk_costs_the_log_and_not_the_run",),
    "rig stopped": ("test_a_stopped_rig_is_said_and_ends_the_session",
                    "test_a_stopped_rig_is_given_up_within_a_second_or_fifty_periods"),
    "rig alive, but no record": ("test_a_silent_rig_that_is_not_stopped_has_ten_times_as_long",),
    "log removed": ("test_a_log_that_is_removed_while_it_is_written_is_said_and_summed_up",),
    "can:hil: no free file descriptor": (
        "test_without_a_free_descriptor_nobody_spins_and_a_newcomer_waits_for_one",
        "test_a_newcomer_without_a_descriptor_is_counted_by_the_link",
    ),
    "can:hil: disk of the channels": ("test_a_mark_that_was_cut_costs_no_life", "test_a_full_disk_is_told_by_an_error"),
    "can:hil: a process stops": ("test_who_cannot_get_the_lock_says_that_somebody_stopped_in_mid_join",
                                 "test_a_lock_on_all_channels_bars_none"),
    "log folder cannot": ("test_read_only_log_folder_is_refused_before_anything_starts",),
    "garbage on the link": ("test_garbage_from_the_link_is_counted_and_changes_nothing",),
    "a second rig or controller of ours": ("test_a_taken_port_is_refused_with_a_hint",
                                           "test_a_bare_uri_is_a_socket_in_a_directory_of_our_own"),
    "a foreign controller answers beside": ("test_who_races_our_controller_with_the_nonce_is_said",
                                            "test_somebody_else_on_the_link_has_an_exit_status_and_a_problem_of_its_own"),
    "answers sent ahead": ("test_answers_sent_ahead_never_command_and_are_said",
                           "test_what_arrives_first_is_heard_first_whatever_time_its_sender_says"),
    "with `auth=`": ("test_with_a_key_who_races_our_controller_is_refused_counted_and_said",
                     "test_what_was_recorded_in_another_session_is_refused"),
    "zenoh: another name": ("test_another_name_of_the_same_authority_is_refused_and_counted",
                            "test_another_authority_and_no_certificate_never_connect",
                            "test_a_password_lets_the_controller_in_and_nobody_else"),
    "a private key": ("test_a_secret_that_others_may_read_is_refused", "test_a_pipe_or_a_device_is_no_key"),
    "foreign frames while": ("test_frames_of_others_delay_the_beginning_by_no_more_than_the_limit_and_are_counted",),
    "a flood of frames": ("test_a_flood_is_said_and_no_late_answer_is_applied",
                          "test_flood_never_holds_the_rig_beyond_the_deadline_or_the_most_frames"),
}  # fmt: skip
"""How a line begins, and what tests it."""

ROOT = Path(__file__).parents[1]
TABLE = (ROOT / "hil/guide/faults.md").read_text(encoding="utf-8").partition("## ")[0]
LINES = [line.split(" | ")[0].removeprefix("| ") for line in TABLE.splitlines() if line.startswith("| ")][1:]


def defined() -> set[str]:
    return {name for path in ROOT.glob("tests/**/test_*.py") for name in re.findall(r"^def (test_\w+)", path.read_text(), re.M)}


@pytest.mark.parametrize("line", LINES)
def test_a_line_of_the_table_has_tests_that_are_there(line: str) -> None:
    found = [names for begin, names in TESTS.items() if line.startswith(begin)]
    assert len(found) == 1, f"{line!r}: no test is named for it in TESTS"
    assert set(found[0]) <= defined()


def test_no_test_is_named_for_a_line_that_is_gone() -> None:
    assert len(LINES) == len(TESTS) and len(LINES) > 15
