#!/bin/sh
# Link the commands finger-… of a colcon workspace into a folder of the PATH.
#   scripts/link_commands.sh install ~/.local/bin
set -eu
install=$(cd "$1" && pwd)
mkdir -p "$2"
for command in "$install"/*/lib/*/finger-*; do
  [ -e "$command" ] || { echo "$install: no commands; build the workspace first" >&2; exit 2; }
  ln -sf "$command" "$2/$(basename "$command")"
done
