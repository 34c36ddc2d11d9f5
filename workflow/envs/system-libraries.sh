#!/bin/sh
# Open3D links against a few system libraries: install them where they are missing and may be,
# else say in one sentence what to install.
set -eu
python=$1
packages=$(tr '\n' ' ' < "$(dirname "$0")/debian-packages.txt")
"$python" -c 'import open3d' 2>/dev/null && exit 0
if command -v apt-get >/dev/null && [ "$(id -u)" = 0 ]; then
  apt-get update -qq
  DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends $packages >/dev/null
fi
"$python" -c 'import open3d' 2>/dev/null && exit 0
echo "Open3D cannot be loaded: install the system libraries it needs (on Debian: sudo apt-get install $packages) and run the same command again." >&2
exit 1
