#!/usr/bin/env bash
# Runs one part of a campaign as a task of a Slurm array. slurm_submit.sh submits array, repetition and merge. Submit
# only the array:
#
#   sbatch --array=0-15 tools/cluster/slurm.sh tools/studies/tyres_and_sensor.toml out/tyres
#
# A part that is killed, fails or reaches its time limit is requeued, at most CFMMR_RESTARTS times (default 5), and
# skips complete blocks. A wrong study or option (exit code 2) is not requeued. Cores per part:
# sbatch --cpus-per-task=N, default 1.
#SBATCH --job-name=cfmmr
#SBATCH --mem-per-cpu=256M
#SBATCH --time=02:00:00
#SBATCH --requeue
#SBATCH --open-mode=append
# Slurm sends USR1 to this script at least 60 s before the time limit.
#SBATCH --signal=B:USR1@60
set -uo pipefail
study=${1:?missing argument: STUDY OUT}
out=${2:?missing argument: STUDY OUT}
cores=${SLURM_CPUS_PER_TASK:-${SLURM_CPUS_ON_NODE:-1}}
restarts=${SLURM_RESTART_COUNT:-0}
most=${CFMMR_RESTARTS:-5}

say() { echo "slurm.sh: $*" >&2; }

if [[ ! $most =~ ^[0-9]{1,4}$ ]]; then
    say "CFMMR_RESTARTS=$most: must be a whole number from 0 to 9999"
    exit 2
fi

"${CFMMR:-cfmmr}" campaign "$study" --out "$out" --threads "$cores" &
part=$!
signal=
# shellcheck disable=SC2317 # called by the traps
stop() {
    signal=$1
    signalled=true
    kill -TERM "$part" 2>/dev/null
}
# The part ends after its current block; after 30 s a second signal ends it at once.
trap 'stop USR1; (sleep 30 && kill -TERM "$part") 2>/dev/null &' USR1
trap 'stop TERM' TERM
# A signal interrupts `wait`.
signalled=true
while [[ $signalled == true ]]; do
    signalled=false
    wait "$part"
    code=$?
done

case $code,$signal in
    0,*) exit 0 ;;
    2,*) say "exit code 2: the study or an option is wrong; not requeued"; exit 2 ;;
    *,TERM) say "cancelled"; exit "$code" ;;
    *,USR1) say "time limit: exit code $code" ;;
    *) say "exit code $code" ;;
esac
if ((restarts >= most)); then
    say "not requeued: restarted $restarts times, at most CFMMR_RESTARTS=$most"
    exit "$code"
fi
say "requeued: restart $((restarts + 1)) of at most $most"
trap '' TERM
# The last task of an array has the array's job number, by which scontrol would requeue every task.
job=${SLURM_JOB_ID:?not in a Slurm job}
if [[ -n ${SLURM_ARRAY_TASK_ID:-} ]]; then
    job=${SLURM_ARRAY_JOB_ID}_$SLURM_ARRAY_TASK_ID
fi
if scontrol requeue "$job"; then
    # Slurm ends this script.
    sleep 60
else
    say "scontrol requeue failed"
fi
exit "$code"
