#!/bin/sh
# Shows what damaged files, hostile input and a busy machine do to the program: one line for each point, with what it did before the
# point was seen to. About a quarter of an hour on two cores, most of which is the compiler's; the last three minutes take the whole
# machine (20 busy loops, which end by themselves).
#
#     scripts/robustness.sh [MUTATIONS]
#
# MUTATIONS: how many times the seeded mutations of an ordinary `make test` are tried (2 makes more than 5,000 inputs).
set -u
cd "$(dirname "$0")/.."
mutations=${1:-2}
cargo=${CARGO:-cargo}
said=$(mktemp)
trap 'rm -f "$said"' EXIT
failed=0
began=$(date +%s)

$cargo build --locked --quiet --bin catoptra || exit 1
$cargo test --locked --quiet --lib --test it --test realtime --no-run || exit 1
echo "built in $(($(date +%s) - began)) s"

# point NAME BEFORE TESTS...: runs tests; how it went, in a line, and the figures that the tests print.
point() {
    name=$1
    before=$2
    shift 2
    from=$(date +%s)
    if CATOPTRA_MUTATIONS=$mutations $cargo test --locked "$@" >"$said" 2>&1 && ! grep -q "running 0 tests" "$said"; then
        echo "ok      $name ($(($(date +%s) - from)) s); before: $before"
    else
        failed=1
        echo "FAILED  $name; before: $before"
        tail -n 20 "$said" | sed 's/^/          /'
    fi
    grep -hE "inputs|not noticed|changed bits|skipped|can be read" "$said" | sed 's/^/          /'
}

point " 1 damaged FFV1 is noticed" "0 of 40 changed bits" --test it media_damage::a_changed_bit_in_our_own
point " 2 checksums of logs, 150 single bits" "3 of 150 noticed, 44 changed numbers" --test it log_damage::every_changed_bit
point " 3 compressed logs are repaired" "emptied, exit code 0" --test it log_damage::a_compressed_log
point " 4 what lies behind a hole is saved" "15 of 1243 messages" --test it log_damage::what_lies_behind
point " 5 a log that is being written is not repaired" "the run went on in the .bak" --test it log_damage::a_log_that_is_being_written
point " 6 a bad window costs its frame" "41 of 60 ended the run" --test it log_damage::a_damaged_window
point " 6 a bad picture costs its frame" "exit code 1" --test it media_damage::a_picture_that_cannot
point " 6 threads do not change the answer" "27 rows with one, 69 with two" --test it media_damage::the_number_of_threads
point " 7 damaged JPEG is noticed" "none" --lib source::jpeg -- --nocapture
point " 7 damaged Motion JPEG is noticed" "13 of 60 measured as good" --test it media_damage::most_damage -- --nocapture
point " 7 a jump is no measurement" "up to 99 mm off at a σ of 0.05 mm" --test it track_motion::
point " 7 true motions are no jumps" "-" --lib track::judge::motion
point " 8 results do not overwrite anything" "input and report were" --test it identify_bad_input::nothing_is_written_over
point "10 a header of 90 gigabytes" "aborted, with all other pictures" --test it hostile_input::a_header
point "11 a changed bit in a schema" "exit code 101" --test it log_damage::a_changed_bit_in_a_schema
point "12 YAML that multiplies itself" "5.9 GB; stack overflow" --test it hostile_input::a_yaml
point "14 large pictures that show nothing" "88 s and 2.8 GB" --test it hostile_input::large_pictures
point "14 15 numbers in a rig" "accepted; more than 60 s" --test it hostile_input::numbers_in_a_rig
point "14 many views of many things" "34 s for 12 frames" --lib track::assign::tests::many_views
point "13 17 19 sources of currents" "20 GB read; exit code 1" --test it hostile_input::sources_of_currents
point "17 currents that are not plausible" "1e308 A in the log" --lib live::currents
point "18 web pages of others" "read along" --test realtime publish::
point "19 a library that floods the terminal" "31,578 lines in 2 minutes" --lib cli::flood
point "19 stopped and continued" "171 lost frames claimed" --test realtime live_raw::
point "20 seeded mutations of every kind of input" "aborts, panics and hangs among 5,471 files" --test it mutations:: -- --nocapture
point "16 load 20, 60 s" "55 % of frames skipped as root" --test realtime live_load::at_a_load_of_20_no -- --ignored --nocapture
point "16 load 20, killed" "1 of 10 with a readable frame" --test realtime live_load::at_a_load_of_20_a -- --ignored --nocapture
echo "all points in $(($(date +%s) - began)) s; $([ $failed = 0 ] && echo good || echo FAILED)"
exit $failed
