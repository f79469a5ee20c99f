#!/usr/bin/env bash
# The shards of a trial through a single-node Slurm of its own, started and ended here; then the same tables as Snakemake's.
#
#     scripts/batch_trial.sh FOLDER && scripts/slurm_trial.sh FOLDER
#
# Needs Debian's slurmctld, slurmd, slurm-client and munge, and root; without them it is skipped. SLURM_ROOT: where they are
# unpacked (dpkg -x), if they are not installed.
set -euo pipefail
folder=$(realpath "$1")
tree=$(cd "$(dirname "$0")/.." && pwd)
catoptra=$(realpath "${CATOPTRA:-$tree/target/release/catoptra}")
python=${PYTHON:-python3}
root=${SLURM_ROOT:-}
plugins=$root/usr/lib/x86_64-linux-gnu/slurm-wlm
export PATH=$root/usr/bin:$root/usr/sbin:$PATH
# The system's own libraries are found anyway, and would come before those of another Python.
if [ -n "$root" ]; then export LD_LIBRARY_PATH=$root/usr/lib/x86_64-linux-gnu:$plugins; fi
ctld=$(command -v slurmctld-wlm || command -v slurmctld || true) slurmd=$(command -v slurmd-wlm || command -v slurmd || true)
if [ -z "$ctld" ] || [ -z "$slurmd" ] || ! command -v munged > /dev/null || [ "$(id -u)" != 0 ]; then
    echo "SKIPPED: Slurm's daemons and munge, run by root, are needed" >&2
    exit 0
fi

place=$(mktemp -d /tmp/catoptra-slurm.XXXXXX)
chmod 755 "$place"
pids=()
end() {
    for pid in "${pids[@]}"; do kill "$pid" 2> /dev/null || true; done
    sleep 1
    rm -rf "$place"
}
trap end EXIT

mkdir -p "$place"/{munge,state,spool}
chmod 700 "$place/munge"
head -c 1024 /dev/urandom > "$place/munge/key"
chmod 600 "$place/munge/key"
munged --foreground --force --key-file="$place/munge/key" --socket="$place/munge.socket" --pid-file="$place/munge/pid" \
    --log-file="$place/munge/log" --seed-file="$place/munge/seed" &
pids+=($!)
host=$(hostname -s)
cat > "$place/slurm.conf" <<CONF
ClusterName=trial
SlurmctldHost=$host(127.0.0.1)
SlurmUser=root
SlurmdUser=root
AuthType=auth/munge
AuthInfo=socket=$place/munge.socket
CryptoType=crypto/munge
PluginDir=$plugins
SlurmctldPort=46817
SlurmdPort=46818
StateSaveLocation=$place/state
SlurmdSpoolDir=$place/spool
SlurmctldPidFile=$place/ctld.pid
SlurmdPidFile=$place/slurmd.pid
SlurmctldLogFile=$place/ctld.log
SlurmdLogFile=$place/slurmd.log
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
SelectType=select/cons_tres
SelectTypeParameters=CR_CPU
ReturnToService=2
NodeName=$host NodeAddr=127.0.0.1 CPUs=$(nproc) RealMemory=8000 State=UNKNOWN
PartitionName=trial Nodes=$host Default=YES MaxTime=INFINITE State=UP
CONF
export SLURM_CONF=$place/slurm.conf
"$ctld" -D -f "$SLURM_CONF" > "$place/ctld.out" 2>&1 &
pids+=($!)
# Debian compiles the place of its helper in.
"$slurmd" -D -f "$SLURM_CONF" -d "$(command -v slurmstepd-wlm || command -v slurmstepd)" > "$place/slurmd.out" 2>&1 &
pids+=($!)
for _ in $(seq 60); do
    sinfo -h -o %T 2> /dev/null | grep -q idle && break
    sleep 0.5
done
sinfo -h -o %T | grep -q idle || { tail -n 5 "$place"/*.log "$place"/*.out >&2; echo "Slurm does not start" >&2; exit 1; }

cd "$folder"
# A trial of Snakemake's has left its results in out: they are kept beside it, as the same folder is written again.
rm -rf slurm-shards out
count=$("$python" "$tree/workflow/shards.py" split runs.tsv --into slurm-shards --size 25)
export CATOPTRA=$catoptra CATOPTRA_WORKFLOW=$tree/workflow CATOPTRA_PAUSE_S=1
submit() {
    sbatch --parsable --array="0-$((count - 1))" --cpus-per-task=1 --mem=0 --requeue "$tree/workflow/slurm_array.sh" \
        slurm-shards out/runs --rig "$tree/calibration/dev_tank/rig.toml"
}
wait_for() { while squeue -h -j "$1" 2> /dev/null | grep -q .; do sleep 0.5; done; }
job=$(submit)
echo "job $job, $count shards; cancelled in the middle"
while [ "$(find out/runs -name summary.json 2> /dev/null | wc -l)" -lt 8 ]; do sleep 0.1; done
scancel --signal=KILL --full "$job"
scancel "$job"
wait_for "$job"
echo "$(find out/runs -name summary.json | wc -l) runs were finished"
job=$(submit)
wait_for "$job"
"$catoptra" collect out/runs -o out/study > /dev/null
"$python" "$tree/scripts/compare_studies.py" undisturbed out
