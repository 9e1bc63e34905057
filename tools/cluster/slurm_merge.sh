#!/usr/bin/env bash
# Merges a campaign after its parts. If blocks are missing, lists them and exits with code 1.
#
#   sbatch --dependency=afterany:JOB --kill-on-invalid-dep=yes tools/cluster/slurm_merge.sh out/tyres
#SBATCH --job-name=cfmmr-merge
#SBATCH --mem=1G
#SBATCH --time=00:30:00
#SBATCH --requeue
set -uo pipefail
out=${1:?missing argument: OUT}
"${CFMMR:-cfmmr}" campaign merge "$out"
code=$?
if ((code == 1)); then
    "${CFMMR:-cfmmr}" campaign status "$out" --missing >&2
fi
if ((code != 0)); then
    echo "slurm_merge.sh: not merged; see the outputs of the parts, then submit them again: complete blocks are kept" >&2
fi
exit "$code"
