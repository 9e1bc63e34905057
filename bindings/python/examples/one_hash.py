"""One table on threads, processes, Ray and Dask: the SHA-256 of its bytes on each; exit code 1 if they differ.

    python one_hash.py

Ray and Dask are left out where they are not installed.
"""

import hashlib
import sys
from concurrent.futures import Executor, ProcessPoolExecutor
from contextlib import contextmanager
from importlib.util import find_spec

import cfmmr


def digest(executor: Executor | None) -> str:
    """Hash of names, types and bytes of all columns of a table of 80 trials."""
    scenarios = cfmmr.Scenario("ordinary").rows("all")
    table = cfmmr.run_many(scenarios, cfmmr.trials(seed=31, count=10), executor=executor, block=4)
    digest = hashlib.sha256()
    for name, values in table.items():
        digest.update(f"{name} {values.dtype}\n".encode())
        digest.update(values.tobytes())
    return digest.hexdigest()


@contextmanager
def threads():
    yield None


@contextmanager
def on_ray():
    import ray
    from many_machines_ray import RayExecutor

    ray.init(address="local", log_to_driver=False)
    try:
        yield RayExecutor()
    finally:
        ray.shutdown()


@contextmanager
def on_dask():
    from distributed import Client

    with Client(n_workers=2, threads_per_worker=1, dashboard_address=None) as client:
        yield client.get_executor()


def main() -> int:
    ways = {"threads": threads, "processes": lambda: ProcessPoolExecutor(2)}
    ways |= {"ray": on_ray} if find_spec("ray") else {}
    ways |= {"dask": on_dask} if find_spec("distributed") else {}
    digests = {}
    for name, way in ways.items():
        with way() as executor:
            digests[name] = digest(executor)
        print(f"{name:10}{digests[name]}", flush=True)
    return 0 if len(set(digests.values())) == 1 else 1


if __name__ == "__main__":
    sys.exit(main())
