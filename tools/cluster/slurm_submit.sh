#!/usr/bin/env bash
# Submits a campaign to Slurm: PARTS parts as an array, a second array if a part of the first fails, then the merge.
#
#   tools/cluster/slurm_submit.sh STUDY OUT PARTS [SBATCH_OPTION...]
#   tools/cluster/slurm_submit.sh tools/studies/tyres_and_sensor.toml out/tyres 16 --cpus-per-task=4
#   squeue --name=cfmmr,cfmmr-merge      # the jobs
#   scancel --name=cfmmr                 # ends the parts; the merge then names the missing blocks
#
# OUT is a directory that every node sees. CFMMR is the program on the nodes (default: cfmmr).
set -euo pipefail
here=$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)
refuse() {
    echo "slurm_submit.sh: $*" >&2
    exit 2
}
(($# >= 3)) || refuse "missing argument: STUDY OUT PARTS [SBATCH_OPTION...]"
study=$1 out=$2 parts=$3
shift 3
[[ -f $study ]] || refuse "STUDY $study: must be a file"
if [[ ! $parts =~ ^[1-9][0-9]{0,6}$ ]] || ((parts > 1000000)); then
    refuse "PARTS $parts: must be a whole number from 1 to 1000000"
fi

array=(sbatch --parsable "--array=0-$((parts - 1))" --kill-on-invalid-dep=yes "$@")
part=("$here/slurm.sh" "$study" "$out")
first=$("${array[@]}" "${part[@]}")
first=${first%%;*}
second=$("${array[@]}" "--dependency=afternotok:$first" "${part[@]}")
second=${second%%;*}
merge=$(sbatch --parsable "$@" "--dependency=afterany:$first:$second" --kill-on-invalid-dep=yes \
    "$here/slurm_merge.sh" "$out")
echo "parts $first, repetition $second if one fails, merge ${merge%%;*}: slurm-${merge%%;*}.out"
