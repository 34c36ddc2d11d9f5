#!/bin/sh
# POV-Ray renders the dissertation's scene: install it where it is missing and may be, else say in
# one sentence what to install.
set -eu
command -v povray >/dev/null && exit 0
if command -v apt-get >/dev/null && [ "$(id -u)" = 0 ]; then
  apt-get update -qq
  DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends povray >/dev/null
fi
command -v povray >/dev/null && exit 0
echo "POV-Ray is missing: install it (on Debian: sudo apt-get install povray) and run the same command again." >&2
exit 1
