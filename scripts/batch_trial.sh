#!/usr/bin/env bash
# Many short recordings through the workflow: once undisturbed, once killed twice, with the same tables at the end.
#
#     scripts/batch_trial.sh FOLDER [COUNT]
#
# CATOPTRA: the program; SNAKEMAKE: Snakemake 9; PYTHON: a Python with pyarrow and polars. Needs ffmpeg. Of COUNT
# recordings (300) three are cut off, two are no videos, one has the wrong size.
set -euo pipefail
folder=$(realpath -m "$1") count=${2:-300}
tree=$(cd "$(dirname "$0")/.." && pwd)
catoptra=$(realpath "${CATOPTRA:-$tree/target/release/catoptra}")
snakemake=${SNAKEMAKE:-snakemake} python=${PYTHON:-python3}
rig=$tree/calibration/dev_tank/rig.toml
mkdir -p "$folder"
cd "$folder"

say() { printf '%s  %s\n' "$(date +%T)" "$*"; }

# 1. recordings: pieces of 8 frames, intra coded, beginning at every second frame of the samples
if [ ! -e recordings/ready ]; then
    say "making $count recordings"
    mkdir -p recordings pieces
    number=0
    for offset in 0 2 4 6 1 3 5 7; do
        for sample in planar circle rest; do
            [ "$number" -lt "$count" ] || continue
            rm -f pieces/*
            ffmpeg -v error -nostdin -i "$tree/sample_frames/$sample.mkv" -vf "trim=start_frame=$offset,setpts=PTS-STARTPTS" \
                -c:v libx264 -preset ultrafast -qp 8 -g 1 -bf 0 -f segment -segment_time 0.125 -reset_timestamps 1 pieces/%03d.mkv
            for piece in pieces/*.mkv; do
                [ "$number" -lt "$count" ] || continue
                mv "$piece" "recordings/$(printf 'run%03d' "$number").mkv"
                number=$((number + 1))
            done
        done
    done
    [ "$number" -eq "$count" ] || { echo "only $number recordings could be made" >&2; exit 1; }
    for k in 5 6 7; do
        truncate -s "$(($(stat -c %s "recordings/run00$k.mkv") * 6 / 10))" "recordings/run00$k.mkv"
    done
    echo "no video" > recordings/run008.mkv
    head -c 30000 /dev/urandom > recordings/run009.mkv
    ffmpeg -v error -nostdin -y -i recordings/run010.mkv -vf scale=640:-2 -c:v libx264 -qp 8 recordings/small.mkv
    mv recordings/small.mkv recordings/run010.mkv
    rm -r pieces
    touch recordings/ready
fi
{
    printf 'recording\tsite\toperator\n'
    for ((k = 0; k < count; k++)); do
        printf 'recordings/run%03d.mkv\tsite %s\toperator %s\n' "$k" "$((k % 3))" "$((k % 7))"
    done
} > runs.tsv

flow() {
    "$snakemake" -s "$tree/workflow/Snakefile" --directory "$folder" --cores 2 --keep-going --rerun-incomplete --quiet all \
        --config manifest=runs.tsv out=out rig="$rig" catoptra="$catoptra" shard_size=25 "$@"
}

# In a session of its own, killed with all that it has begun: by the number of its group.
killed_when() {
    local done_before=$1
    setsid bash -c "$(declare -f flow); snakemake='$snakemake' tree='$tree' folder='$folder' rig='$rig' catoptra='$catoptra'; flow" \
        > killed.log 2>&1 &
    local group=$!
    while [ "$(find out/runs -name summary.json 2>/dev/null | wc -l)" -lt "$done_before" ] && kill -0 "$group" 2>/dev/null; do sleep 0.05; done
    # Somewhere in the middle of a run, or two.
    sleep "0.$((RANDOM % 10))"
    kill -KILL -- "-$group"
    wait "$group" 2>/dev/null || true
    sleep 0.5
    say "killed with $(find out/runs -name summary.json | wc -l) runs finished, $(find out/runs -mindepth 1 -maxdepth 1 -type d | wc -l) begun"
    flow --unlock
}

# 2. undisturbed, then killed twice
if [ ! -e undisturbed ]; then
    rm -rf out .snakemake
    say "undisturbed"
    began=$(date +%s.%N)
    flow > undisturbed.log 2>&1 || { tail -n 30 undisturbed.log; exit 1; }
    say "took $(echo "$(date +%s.%N) - $began" | bc) s"
    mv out undisturbed
fi
rm -rf out .snakemake
killed_when $((count / 5))
killed_when $((count * 3 / 5))
say "resumed"
flow > resumed.log 2>&1 || { tail -n 30 resumed.log; exit 1; }

# 3. the same, but for times of day
"$python" "$tree/scripts/compare_studies.py" undisturbed out
