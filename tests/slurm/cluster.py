"""A Slurm cluster of this one machine, for as long as a test takes; stopped by process id."""

import getpass
import os
import shutil
import socket
import subprocess
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

_START_S = 60
_CONFIG = """\
ClusterName=treadlight
SlurmctldHost={host}(127.0.0.1)
SlurmUser={user}
SlurmdUser={user}
AuthType=auth/munge
AuthInfo=socket={folder}/munge.socket
CredType=cred/munge
SlurmctldPort={controller_port}
SlurmdPort={node_port}
SlurmctldPidFile={folder}/slurmctld.pid
SlurmdPidFile={folder}/slurmd.pid
StateSaveLocation={folder}/state
SlurmdSpoolDir={folder}/spool
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
# The node promises what the test asks for, whatever this machine has.
SlurmdParameters=config_overrides
MpiDefault=none
ReturnToService=2
SelectType=select/cons_tres
SelectTypeParameters=CR_CPU_Memory
AccountingStorageType=accounting_storage/none
JobAcctGatherType=jobacct_gather/none
# Finished jobs stay in squeue's sight until the workflow has asked for them.
MinJobAge=3600
NodeName={host} NodeAddr=127.0.0.1 CPUs={cpus} RealMemory={memory_mb} State=UNKNOWN
PartitionName=all Nodes=ALL Default=YES MaxTime=INFINITE State=UP
"""


@contextmanager
def cluster(cpus: int, memory_mb: int) -> Iterator[dict[str, str]]:
    """The environment in which sbatch finds the cluster; `memory_mb` is what its node promises."""
    # Sockets want a short path.
    folder = Path(tempfile.mkdtemp(prefix="slurm-"))
    folder.chmod(0o755)
    started: list[subprocess.Popen] = []
    environment = os.environ | {
        "SLURM_CONF": str(folder / "slurm.conf"),
        "PATH": f"{folder}/bin{os.pathsep}{os.environ['PATH']}",
    }
    try:
        _write_config(folder, cpus, memory_mb)
        (folder / "munge.key").write_bytes(os.urandom(128))
        (folder / "munge.key").chmod(0o400)
        for command in _commands(folder):
            log = (folder / f"{Path(command[0]).name}.out").open("w")
            started.append(subprocess.Popen(command, env=environment, stdout=log, stderr=log))
        _wait(folder, started, environment)
        yield environment
    finally:
        for process in reversed(started):
            process.terminate()
        for process in started:
            try:
                process.wait(30)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
        shutil.rmtree(folder, ignore_errors=True)


def _commands(folder: Path) -> list[list[str]]:
    """munge, the controller and the node, each in the foreground: its id is its process's."""
    munge = [_program("munged"), "--foreground", "--force"]
    munge += [f"--socket={folder}/munge.socket", f"--key-file={folder}/munge.key"]
    munge += [f"--{kind}-file={folder}/munge.{kind}" for kind in ("log", "pid", "seed")]
    return [munge, [_program("slurmctld"), "-D", "-c"], [_program("slurmd"), "-D"]]


def _program(name: str) -> str:
    found = shutil.which(name, path=f"{os.environ['PATH']}:/usr/sbin:/sbin")
    if found is None:
        raise SystemExit(f"There is no {name}: sh workflow/envs/slurm.sh installs it.")
    return found


def _write_config(folder: Path, cpus: int, memory_mb: int) -> None:
    for name in ("state", "spool"):
        (folder / name).mkdir()
    controller_port, node_port = _free_ports(2)
    text = _CONFIG.format(
        host=socket.gethostname().partition(".")[0],
        user=getpass.getuser(),
        folder=folder,
        controller_port=controller_port,
        node_port=node_port,
        cpus=cpus,
        memory_mb=memory_mb,
    )
    (folder / "slurm.conf").write_text(text)
    # Within jobs Snakemake clears the environment of SLURM_*, where srun is told of its cluster.
    srun = folder / "bin/srun"
    srun.parent.mkdir()
    srun.write_text(f'#!/bin/sh\nSLURM_CONF={folder}/slurm.conf exec {_program("srun")} "$@"\n')
    srun.chmod(0o755)


def _free_ports(count: int) -> list[int]:
    sockets = [socket.socket() for _ in range(count)]
    for each in sockets:
        each.bind(("127.0.0.1", 0))
    ports = [each.getsockname()[1] for each in sockets]
    for each in sockets:
        each.close()
    return ports


def _wait(folder: Path, started: list[subprocess.Popen], environment: dict[str, str]) -> None:
    """Until the node is idle."""
    command = ["sinfo", "--noheader", "--format=%T"]
    for _ in range(_START_S):
        done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
        if done.stdout.strip() == "idle":
            return
        if any(process.poll() is not None for process in started):
            break
        time.sleep(1)
    said = "\n".join(path.read_text(errors="replace")[-2000:] for path in folder.glob("*.out"))
    raise SystemExit(
        f"Slurm does not start ({done.stdout.strip() or done.stderr.strip()}):\n{said}"
    )
