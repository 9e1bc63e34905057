"""Trials on a Ray cluster: an executor of concurrent.futures over Ray's tasks.

    pip install ray
    python many_machines_ray.py              # a cluster of this machine
    python many_machines_ray.py auto         # the cluster that this machine belongs to

Every node needs the package cfmmr. A task whose worker is lost is repeated, with the same result.
"""

import sys
from concurrent.futures import Executor, Future
from typing import Any

import ray

import cfmmr


@ray.remote
def call(function, arguments, keywords):
    return function(*arguments, **keywords)


class RayExecutor(Executor):
    """Runs each call as a task of Ray."""

    def submit(self, function: Any, /, *arguments: Any, **keywords: Any) -> Future:
        return call.remote(function, arguments, keywords).future()


def main():
    ray.init(address=sys.argv[1] if len(sys.argv) > 1 else "local", log_to_driver=False)
    scenarios = cfmmr.Scenario("careful").rows("pair")
    with RayExecutor() as executor:
        table = cfmmr.run_many(scenarios, cfmmr.trials(seed=31, count=20), executor=executor, block=4)
    for row in cfmmr.summary(table):
        print(f"{row['fusion']:8}  goal error {100 * row['e_m']:.1f} ± {100 * row['e_m_sd']:.1f} cm, {row['ends']}")
    ray.shutdown()


if __name__ == "__main__":
    main()
