"""Trials on a Dask cluster: the executor of its client.

    pip install dask distributed
    python many_machines_dask.py                       # a cluster of this machine
    python many_machines_dask.py tcp://scheduler:8786  # a running cluster

Every node needs the package cfmmr. A task whose worker is lost is repeated, with the same result.
"""

import sys

from distributed import Client

import cfmmr


def main():
    # Without an address: two processes on this machine, each with one thread.
    local = {"n_workers": 2, "threads_per_worker": 1, "dashboard_address": None}
    client = Client(sys.argv[1]) if len(sys.argv) > 1 else Client(**local)
    scenarios = cfmmr.Scenario("careful").rows("pair")
    with client, client.get_executor() as executor:
        table = cfmmr.run_many(scenarios, cfmmr.trials(seed=31, count=20), executor=executor, block=4)
    for row in cfmmr.summary(table):
        print(f"{row['fusion']:8}  goal error {100 * row['e_m']:.1f} ± {100 * row['e_m_sd']:.1f} cm, {row['ends']}")


if __name__ == "__main__":
    main()
