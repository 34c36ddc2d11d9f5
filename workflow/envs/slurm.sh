#!/bin/sh
# A Slurm controller, node and munge for the test of the queue: install Debian's where they are
# missing and may be, else say in one sentence what to install. Nothing is started here.
set -eu
present() {
  for name in slurmctld slurmd munged; do
    command -v "$name" >/dev/null || test -x "/usr/sbin/$name" || return 1
  done
}
present && exit 0
if command -v apt-get >/dev/null && [ "$(id -u)" = 0 ]; then
  apt-get update -qq
  # Debian would start them at once: the test starts its own.
  RUNLEVEL=1 DEBIAN_FRONTEND=noninteractive \
    apt-get install -y -qq --no-install-recommends slurm-wlm munge >/dev/null
fi
present && exit 0
echo "Slurm is missing: install it (on Debian: sudo apt-get install slurm-wlm munge) and run the same command again." >&2
exit 1
