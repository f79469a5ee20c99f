#!/bin/sh
# Shows what damaged files, hostile input and a busy machine do to the program: one line for each point, in about a quarter of
# an hour on two cores, most of which is the compiler's.
#
#     scripts/robustness.sh [MUTATIONS]
#
# MUTATIONS: how many times the seeded mutations of an ordinary `make test` are tried (3 makes more than 5,000 inputs).
set -u
cd "$(dirname "$0")/.."
mutations=${1:-3}
cargo=${CARGO:-cargo}
place=$(mktemp -d)
trap 'rm -rf "$place"' EXIT
failed=0

$cargo build --locked --quiet --bin catoptra || exit 1
$cargo test --locked --quiet --lib --test it --test realtime --no-run || exit 1
catoptra=$(pwd)/target/debug/catoptra

# Runs tests; one line with how it went.
point() {
    name=$1
    shift
    if CATOPTRA_MUTATIONS=$mutations $cargo test --locked --quiet "$@" >"$place/said" 2>&1; then
        echo "ok      $name"
        grep -hE "inputs|not noticed|changed bits" "$place/said" | sed 's/^/          /'
    else
        failed=1
        echo "FAILED  $name"
        tail -n 20 "$place/said" | sed 's/^/          /'
    fi
}

point " 1 damaged FFV1 is noticed" --test it media_damage::a_changed_bit_in_our_own
point " 2 checksums of logs, 150 single bits" --test it log_damage::every_changed_bit
point " 3 compressed logs are repaired" --test it log_damage::a_compressed_log
point " 4 what lies behind a hole is saved" --test it log_damage::what_lies_behind
point " 5 a log that is being written is not repaired" --test it log_damage::a_log_that_is_being_written
point " 6 a bad window costs its frame" --test it log_damage::a_damaged_window
point " 6 a bad picture costs its frame" --test it media_damage::a_picture_that_cannot
point " 6 threads do not change the answer" --test it media_damage::the_number_of_threads
point " 7 damaged JPEG is noticed" --lib source::jpeg -- --nocapture
point " 7 damaged Motion JPEG is noticed" --test it media_damage::most_damage -- --nocapture
point "10 a header of 90 gigabytes" --test it hostile_input::a_header
point "11 a changed bit in a schema" --test it log_damage::a_changed_bit_in_a_schema
point "12 YAML that multiplies itself" --test it hostile_input::a_yaml
point "14 15 numbers in a rig" --test it hostile_input::numbers_in_a_rig
point "13 17 19 sources of currents" --test it hostile_input::sources_of_currents
point "17 currents that are not plausible" --lib live::currents
point "18 web pages of others" --test realtime publish::
point "19 a library that floods the terminal" --lib cli::flood
point "20 seeded mutations of every kind of input" --test it mutations:: -- --nocapture

# 16: live at a load of 20, for 60 s.
long=sample_frames/planar.mkv
if command -v ffmpeg >/dev/null; then
    long=$place/long.mkv
    ffmpeg -v error -stream_loop 11 -i sample_frames/planar.mkv -c copy "$long"
fi
# In sessions of their own, as other terminals are.
for _ in $(seq 20); do setsid sh -c "$(printf 'end=%s; while [ "$(date +%%s)" -lt "$end" ]; do i=0; while [ $i -lt 20000 ]; do i=$((i + 1)); done; done' $(($(date +%s) + 75)))" & done
"$catoptra" -v live "$long" --realtime --rig sample_frames/truth/rig.toml --duration 60 -o "$place/live" \
    >"$place/said" 2>&1
code=$?
wait
echo "        16 live at a load of 20: exit code $code; $(grep -m1 priority "$place/said")"
"$catoptra" log info "$place/live/log.mcap" | grep -E "frames|skipped" | sed 's/^/          /'
exit $failed
