# SPDX-License-Identifier: Apache-2.0
# Run on boards r and a (tools/vm/boards.py): the steps of tools/vm/on_board.py that are asked for.
export PYTHONPATH=/lithe/brain LITHE_BIN_DIR=/lithe/bin LITHE_OUT_DIR=/tmp/out LITHE_CACHE_DIR=/tmp/cache
mount -t cgroup2 none /sys/fs/cgroup # as every Debian has it
# lawd compiles the contract's header when it starts. Here that takes longer than a robot waits for a law.
echo '{"verb": "ping"}' | lawd 3</dev/null >/tmp/lawd.log 2>&1
python3 -u /lithe/on_board.py $(cat /lithe/steps)
