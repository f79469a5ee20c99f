#!/usr/bin/env bash
# The shards of a manifest as a Slurm job array, for those who do not use Snakemake: docs/cluster.md.
#
#     shards=$(python3 workflow/shards.py split runs.tsv --into shards)
#     sbatch --array=0-$((shards - 1)) workflow/slurm_array.sh shards runs --rig rig.toml
#     catoptra collect runs -o study                          # when all are done
#
# The same line again does what is left: what was finished is left out.
#SBATCH --job-name=catoptra
#SBATCH --cpus-per-task=4
#SBATCH --mem=2500M
#SBATCH --time=04:00:00
#SBATCH --requeue
#SBATCH --output=catoptra-%A_%a.log
set -euo pipefail
shards=$1 runs=$2
shift 2
shard=$shards/$(printf '%04d' "${SLURM_ARRAY_TASK_ID:?is set by sbatch --array}").tsv
# Slurm runs a copy of this script; what is beside the original is not beside the copy.
settle=${CATOPTRA_WORKFLOW:-$SLURM_SUBMIT_DIR/workflow}/shards.py

for attempt in 1 2 3; do
    code=0
    "${CATOPTRA:-catoptra}" --quiet track --manifest "$shard" "$@" -o "$runs" \
        --jobs "${SLURM_CPUS_PER_TASK:-1}" --threads 1 --resume || code=$?
    # 1: some recordings failed. Wrong usage and an interrupt are no matter of another attempt.
    [ "$code" -le 1 ] || exit "$code"
    python3 "$settle" settle "$shard" "$runs" && exit 0
    sleep "${CATOPTRA_PAUSE_S:-60}"
done
exit 1
