#!/usr/bin/env bash
# A campaign as a Slurm array, one part a task:
#
#   sbatch --array=0-15 tools/cluster/slurm.sh tools/studies/tyres_and_sensor.toml out/tyres
#   sbatch --dependency=afterok:JOB --wrap "cfmmr campaign merge out/tyres"
#
# The parts read their number from the array. A task that was killed is repeated with the same line:
# what it had finished is left alone.
#SBATCH --job-name=cfmmr
#SBATCH --cpus-per-task=4
#SBATCH --mem=1G
#SBATCH --time=02:00:00
#SBATCH --requeue
# A minute before the limit the part ends with what it has finished.
#SBATCH --signal=B:INT@60
set -euo pipefail
study=${1:?the study, a TOML file}
out=${2:?the directory of its files, seen by every node}
exec "${CFMMR:-cfmmr}" campaign "$study" --out "$out" --threads "${SLURM_CPUS_PER_TASK:-1}"
