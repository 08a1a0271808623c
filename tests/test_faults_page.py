"""Every line of the guide's table of faults has tests, by name, and they are there."""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path

import pytest

TESTS: dict[str, tuple[str, ...]] = {
    "controller killed": (
        "test_killed_controller_leaves_the_rig_up_in_its_safe_state_and_said",
        "test_stopped_controller_trips_the_watchdog_and_does_not_outlive_the_session",
        "test_controller_that_dies_is_followed_by_hold_then_the_latched_safe_state",
    ),
    "standard output that cannot be written": ("test_a_fault_of_the_machine_is_one_line",),
    "rig killed": ("test_killed_rig_ends_the_session_and_keeps_the_log",),
    "session killed (-9), its": ("test_the_next_session_clears_what_a_killed_one_left",
                                 "test_a_channel_of_killed_processes_is_removed_and_a_live_one_stays"),
    "session killed (-9)": ("test_killed_session_leaves_no_orphan_and_a_log_whole_but_for_the_last_tenth",),
    "Ctrl-C": ("test_stop_ends_everything_and_closes_the_log", "test_all_are_asked_at_once_share_one_grace_and_are_killed"),
    "a signal while `hil`": ("test_a_signal_while_the_command_line_is_imported_ends_it_without_a_word",
                             "test_the_console_command_heeds_signals_first"),
    "a command in `hil vcan`": ("test_what_a_guest_does_to_its_kernel_ends_it_with_a_status_of_ours",
                                "test_last_words_are_the_kernels_and_no_file_that_the_guest_points_at",
                                "test_a_signal_at_any_instant_ends_it_with_its_status_and_without_a_traceback"),
    "started with a signal ignored": ("test_what_is_ignored_stays_ignored_and_sigterm_still_stops",),
    "a plug-in of Python": ("test_a_plug_in_that_fails_in_mid_run_is_one_message_and_a_whole_log",
                            "test_a_plug_in_that_never_returns_is_ended_by_a_signal_with_its_log"),
    "TAB (completion)": ("test_completion_runs_nothing_that_an_experiment_names",),
    "your module prints": ("test_what_a_module_of_ones_own_prints_stays_out_of_the_json",
                                          "test_json_is_one_document_whatever_a_module_prints"),
    "your module ends": ("test_a_module_that_leaves_or_changes_its_process_is_one_message",
                                        "test_a_worker_of_a_sweep_that_is_ended_is_one_message",
                                        "test_a_rig_that_a_module_ends_with_status_0_is_lost",
                                        "test_a_pytest_is_not_ended_by_a_module"),
    "C code of your module": ("test_a_script_is_its_authors_and_ends_as_the_c_code_of_a_module_ends_it",
                              "test_a_worker_of_pytest_that_c_code_of_a_module_ends_is_one_failed_test_and_the_others_run"),
    "your module hangs": ("test_a_module_that_hangs_ends_by_a_signal",),
    "`--json` with standard": ("test_json_for_a_closed_output_runs_nothing",),
    "a measure that fails": ("test_a_measure_that_fails_behind_its_check_leaves_the_log_and_the_other_numbers",),
    "a signal before": ("test_a_signal_before_the_first_record_leaves_no_empty_log",
                        "test_what_another_run_has_begun_is_not_removed"),
    "an FMU that fails": ("test_a_unit_that_fails_in_a_step_is_one_message_and_a_whole_log",
                          "test_a_unit_without_an_end_is_ended_by_a_signal", "test_what_a_unit_prints_stays_out_of_our_output",
                          "test_in_real_time_a_unit_that_crashes_ends_the_session_in_order"),
    "an FMU that starts": ("test_what_a_unit_starts_and_leaves_ends_with_the_session",
                           "test_a_unit_that_fails_in_a_step_is_one_message_and_a_whole_log"),
    "a session with an FMU": ("test_the_folder_of_a_killed_session_goes_with_it",
                              "test_what_a_killed_host_left_is_removed_by_the_next_and_what_runs_is_not"),
    "link cut": ("test_link_down_for_a_second_trips_the_watchdog_whose_safe_state_stays",
                 "test_a_cut_cable_is_survived_and_both_ends_meet_again"),
    "disk full: a run": ("test_full_disk_costs_the_log_and_not_the_run",
                    "test_a_virtual_run_beyond_the_limit_of_a_file_ends_in_order_and_recovers",
                    "test_a_virtual_run_on_a_full_disk_ends_in_order"),
    "a disk that takes no record": ("test_a_disk_too_small_for_one_record_is_named_and_leaves_no_file",),
    "disk full while `hil export`": ("test_an_export_on_a_full_disk_leaves_all_tables_or_none",),
    "rig stopped": ("test_a_stopped_rig_is_said_and_ends_the_session",
                    "test_a_stopped_rig_is_given_up_within_a_second_or_fifty_periods"),
    "rig alive, but no record": ("test_a_silent_rig_that_is_not_stopped_has_ten_times_as_long",),
    "log removed": ("test_a_log_that_is_removed_while_it_is_written_is_said_and_summed_up",),
    "can:hil: more than 64": ("test_a_flood_of_newcomers_is_let_in_up_to_a_number",),
    "can:hil: no free file descriptor": (
        "test_without_a_free_descriptor_no_process_spins_and_a_joining_one_waits",
        "test_a_participant_without_a_descriptor_is_counted_by_the_link",
    ),
    "can:hil: disk of the channels": ("test_a_mark_that_was_cut_costs_no_life", "test_a_full_disk_is_reported_by_an_error"),
    "can:hil: a process stops": ("test_a_lock_that_is_not_free_is_reported_as_a_process_stopped_in_mid_join",
                                 "test_a_lock_on_all_channels_bars_none"),
    "log folder cannot": ("test_read_only_log_folder_is_refused_before_anything_starts",),
    "a `matplotlibrc`": ("test_a_matplotlibrc_of_the_folder_is_not_read",),
    "a `pickle.py`": ("test_no_file_of_the_working_folder_runs", "test_every_python_of_ours_starts_without_its_working_folder",
                      "test_the_module_that_the_experiment_names_runs_in_both_processes_and_imports_what_lies_beside_it"),
    "garbage on the link": ("test_garbage_from_the_link_is_counted_and_changes_nothing",),
    "a second `hil` rig or": ("test_a_taken_port_is_refused_with_a_hint",
                                           "test_a_bare_uri_is_a_socket_in_a_directory_of_our_own",
                                           "test_a_second_controller_is_refused_until_the_first_has_gone"),
    "a second `hil controller` over": (
        "test_a_second_controller_from_another_machine_is_refused_and_a_death_frees_the_role",
        "test_what_a_refused_controller_says_before_it_knows_reaches_no_process",
        "test_of_controllers_that_wait_for_one_rig_one_is_received", "test_a_controller_in_another_network_is_refused_too",
    ),
    "another user holds": ("test_a_claim_is_a_file_that_no_other_user_reaches",
                           "test_a_directory_that_others_may_enter_or_that_is_a_link_is_refused"),
    "too few file": ("test_a_run_without_descriptors_is_one_message_with_status_2",),
    "a foreign controller answers too": ("test_a_second_controller_with_the_nonce_is_reported",
                                            "test_another_process_on_the_link_has_an_exit_status_and_a_problem_of_its_own"),
    "answers sent ahead": ("test_answers_sent_ahead_never_command_and_are_said",
                           "test_what_arrives_first_is_received_first_whatever_time_its_sender_says"),
    "zenoh: a certificate": ("test_what_the_other_end_would_refuse_says_why", "test_a_refused_login_is_counted",
                             "test_a_controller_whose_rig_is_of_another_authority_says_so"),
    "zenoh: a name that is revoked": (
        "test_a_revoked_name_is_refused_at_both_ends_and_another_one_takes_its_place",
        "test_the_old_key_of_a_revoked_name_connects_and_is_kept_silent_counted_and_said",
        "test_a_list_that_is_none_opens_no_link",
    ),
    "a link without key": ("test_doctor_names_the_possible_commanders_in_one_line",
                           "test_over_tls_the_session_runs_and_names_the_possible_commanders"),
    "a directory of sockets": ("test_a_directory_open_to_others_is_refused_with_the_remedy",
                               "test_a_bare_uri_is_a_socket_in_a_directory_of_our_own"),
    "forged questions to": (
        "test_no_forged_question_of_a_slot_that_has_not_begun_is_answered_used_or_outdates_the_true_ones",
        "test_one_forged_number_far_ahead_does_not_silence_the_controller",
        "test_a_forged_hello_neither_ends_the_session_nor_resets_the_control_law",
        "test_a_forged_frame_before_the_true_one_of_the_slot_shows_in_the_echo_and_is_counted",
        "test_forged_questions_are_refused_said_and_leave_every_answer_as_it_was",
        "test_an_answer_to_other_frames_than_were_sent_is_never_applied_and_is_reported",
    ),
    "with `auth=`": ("test_with_a_key_a_second_controller_is_refused_counted_and_reported",
                     "test_what_was_recorded_in_another_session_is_refused"),
    "a file, link or folder": ("test_no_file_is_removed_for_a_socket",),
    "zenoh over tcp: connections that say": (
        "test_connections_that_are_no_session_are_counted_and_none_that_says_nothing_is_closed",
        "test_what_both_ends_of_a_link_counted_is_read_from_their_events",
    ),
    "zenoh over tcp: connections that send": (
        "test_connections_that_are_no_session_are_counted_and_none_that_says_nothing_is_closed",
    ),
    "zenoh: another name": ("test_another_name_of_the_same_authority_is_refused_and_counted",
                            "test_another_authority_and_no_certificate_never_connect",
                            "test_a_password_lets_the_controller_in_and_no_other"),
    "a private key": ("test_a_secret_that_others_may_read_is_refused", "test_a_pipe_or_a_device_is_no_key"),
    "foreign frames while": ("test_frames_of_others_delay_the_beginning_by_no_more_than_the_limit_and_are_counted",),
    "slots that take longer": ("test_the_watchdog_trips_by_the_clock_where_slots_take_longer",
                               "test_the_watchdog_keeps_its_time_under_every_flood_at_1_khz"),
    "a flood of frames": ("test_frames_that_a_filter_keeps_out_hold_no_call_and_are_counted",
                          "test_a_flood_is_said_and_no_late_answer_is_applied",
                          "test_eight_senders_for_ten_seconds_make_no_slot_late_and_are_said",
                          "test_flood_never_holds_the_rig_beyond_the_deadline_or_the_most_frames"),
    # Faults on a time line
    "`cut`": ("test_a_cut_loses_what_would_arrive_and_nothing_else",
              "test_a_fault_breaks_what_it_says_is_reported_and_replayed_bit_for_bit"),
    "`corrupt`": ("test_of_a_corrupted_frame_one_bit_is_wrong_and_the_controller_refuses_it",),
    "`freeze`": ("test_a_node_off_the_bus_sends_nothing_and_a_frozen_one_repeats_its_values",),
    "`bus-off`": ("test_a_node_off_the_bus_sends_nothing_and_a_frozen_one_repeats_its_values",
                  "test_a_controller_off_the_bus_receives_nothing"),
    "`controller-restart`": ("test_a_restart_forgets_the_newest_sample",
                             "test_a_restart_on_the_time_line_ends_the_controller_process_and_starts_another"),
    # Foreign files
    "experiment": ("test_text_that_costs_too_much_is_refused", "test_fault_is_named_by_its_path",
                   "test_what_is_not_finite_is_said_once", "test_what_has_no_end_or_no_beginning_is_refused_at_once"),
    "names, keys": ("test_an_experiment_cannot_write_to_the_terminal", "test_nothing_that_moves_a_cursor_gets_through",
                    "test_a_log_with_markup_in_its_name_is_reported_under_its_name"),
    "design": ("test_faulty_design_files_are_refused_with_path_and_field",
               "test_what_has_no_end_or_no_beginning_is_no_design_file"),
    "cache entry": ("test_damaged_cache_entry_is_solved_again", "test_a_damaged_entry_costs_the_time_of_solving",
                    "test_user_without_a_home_has_no_cache_and_gets_a_design"),
    "FMU": ("test_a_unit_that_is_none_is_refused_before_anything_runs",),
    "your module": ("test_what_is_no_plant_is_refused_in_a_sentence",
                            "test_a_law_that_is_none_is_refused_in_its_author_s_words"),
    "trace of ages": ("test_a_pipe_is_not_waited_for_and_a_trace_has_an_end",),
    "file of numbers": ("test_a_file_that_is_none_is_refused_by_its_name_and_key",
                        "test_what_is_real_is_read_and_what_is_damaged_refused_with_one_message"),
    "recorded packets, traffic": ("test_what_the_fuzz_found_stays_refused",
                                  "test_a_capture_without_an_end_is_refused",
                                  "test_what_is_real_is_read_and_what_is_damaged_refused_with_one_message"),
    "traffic of a bus": ("test_traffic_that_would_take_minutes_is_refused",
                         "test_a_dbc_with_a_message_of_a_hundred_million_bits_is_refused_at_once"),
    "answers to `hil probe`": (
        "test_an_answer_of_an_instant_that_no_clock_reads_is_none",
        "test_an_end_that_dates_answers_before_the_question_or_after_their_arrival_has_another_clock",
    ),
    "CAN log": ("test_what_the_fuzz_found_stays_refused", "test_what_is_no_can_log_is_refused"),
    "file of a sweep": ("test_a_row_that_is_none_is_one_message", "test_a_line_without_end_is_no_sweep"),
    "log that unpacks": ("test_a_few_bytes_do_not_cost_gigabytes", "test_zeros_behind_the_log_are_no_records",
                         "test_a_file_unpacks_to_so_many_times_its_length_and_no_byte_more"),
    "log with a flipped bit": ("test_no_flipped_bit_is_read_without_a_word",
                               "test_recovery_says_that_a_flipped_schema_is_not_what_was_written"),
    "log that hil did not write": ("test_a_log_of_more_topics_than_a_session_has_is_refused",
                                   "test_a_field_of_another_name_or_type_is_named_and_a_topic_may_lack",
                                   "test_an_event_of_another_kind_is_named", "test_an_experiment_of_other_types_is_named",
                                   "test_a_seed_that_is_none_is_named", "test_a_summary_of_other_types_is_named"),
    "log whose frames": ("test_answers_out_of_order_are_sorted_up_to_a_limit", "test_few_frames_wait_for_one_that_came_late"),
    "log of 10^7 slots": ("test_writing_holds_no_more_for_a_longer_run", "test_closing_holds_no_index_of_a_long_run",
                          "test_reading_holds_no_more_for_a_longer_log", "test_asking_holds_no_more_for_a_longer_log",
                          "test_a_cost_in_pieces_is_that_of_whole_arrays_and_never_holds_them",
                          "test_want_of_memory_is_not_called_a_torn_log"),
    "anything at all": ("test_what_another_program_writes_is_read_or_refused_with_one_message",
                        "test_a_million_inputs_are_read_or_refused_with_one_message",
                        "test_a_message_has_at_most_2_kB_and_says_what_it_left_out"),
    # Behind a fault
    "one that lasts to the end": ("test_a_fault_that_may_leave_something_behind_leaves_a_loop_undecided",),
    "`bit-errors`, and": ("test_a_fault_that_may_leave_something_behind_leaves_a_loop_undecided",),
    "one that takes samples": ("test_a_fault_that_may_leave_something_behind_leaves_a_loop_undecided",),
    "any, where a region": ("test_a_fault_that_may_leave_something_behind_leaves_a_loop_undecided",),
    "any, where `limits.passivity`": ("test_a_fault_that_may_leave_something_behind_leaves_a_loop_undecided",),
    "one in which the actuator": ("test_a_loop_is_certified_where_no_fault_can_trip_the_watchdog",
                                  "test_a_law_that_loses_commands_may_trip_the_watchdog_behind_a_fault"),
    # What hil writes
    "`hil run --force` on a": ("test_force_goes_through_no_link",),
    "two runs with": ("test_two_runs_never_write_one_file", "test_a_run_holds_its_log_while_it_writes"),
    "a file of that name": ("test_an_export_replaces_nothing_unasked", "test_a_page_replaces_only_a_page",
                            "test_a_file_that_came_during_the_work_is_kept"),
    "a symbolic link": ("test_an_export_follows_no_link", "test_a_new_file_takes_its_place_whole_and_through_nobodys_link"),
    "the work or the disk": ("test_what_does_not_fit_leaves_the_old_file_and_nothing_else", "test_a_failure_leaves_nothing"),
    "others on this machine": ("test_a_log_is_its_users_alone_unless_asked_otherwise",),
    "another program reads": ("test_numpy_reads_the_arrays_back", "test_a_table_reads_back_to_the_last_bit",
                              "test_a_can_log_holds_the_frames_of_the_link",
                              "test_peaks_text_format_takes_classic_frames_only"),
    "a run of hours": ("test_a_short_soak_measures_every_process_the_log_and_the_sessions",
                       "test_no_node_of_a_rig_grows_with_its_slots", "test_a_busy_machine_is_no_fault_of_the_rig",
                       "test_a_chunk_that_is_written_leaves_no_memory_behind"),
    # What is installed
    "a package is not": ("test_every_package_is_pinned_with_its_hashes", "test_build_and_installer_are_pinned_with_their_hashes",
                         "test_every_install_of_the_makefile_checks_hashes_and_fetches_nothing_else"),
    "a licence asks": ("test_every_installed_package_is_listed_with_its_licence",),
}  # fmt: skip
"""How a line begins, and what tests it."""

ROOT = Path(__file__).parents[1]
TEXT, _, _ = (ROOT / "hil/guide/faults.md").read_text(encoding="utf-8").partition("\n## Attacks\n")  # whose table is generated
PAGE = TEXT.splitlines()
HEADS = [after - 1 for after, line in enumerate(PAGE) if line.startswith("|---")]
LINES = [line.split(" | ")[0].removeprefix("| ") for i, line in enumerate(PAGE) if line.startswith("| ") and i not in HEADS]


@cache
def defined() -> set[str]:
    return {name for path in ROOT.glob("tests/**/test_*.py") for name in re.findall(r"^def (test_\w+)", path.read_text(), re.M)}


@pytest.mark.parametrize("line", LINES)
def test_a_line_of_the_table_has_tests_that_are_there(line: str) -> None:
    begins = sorted((begin for begin in TESTS if line.startswith(begin)), key=len)
    found = [TESTS[begin] for begin in begins[-1:]]
    assert len(found) == 1, f"{line!r}: no test is named for it in TESTS"
    assert set(found[0]) <= defined()


def test_no_test_is_named_for_a_line_that_is_gone() -> None:
    assert len(LINES) == len(TESTS) and len(LINES) > 40
