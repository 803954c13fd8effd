#!/usr/bin/env bash
# Failures from public reports, one script a case: each makes the situation, and exits with 0 if the program does what is
# expected, with 1 if it does not. A package that a case needs and that is absent is a failure, too: nothing is skipped.
#
#   bash tests/cases/full.sh MURMURATE PYTHON [NAME...]
#
# MURMURATE is built with the features lab, ros2 and zenoh; PYTHON has the package, mcap, zstandard, lz4, rclpy and the
# trainers (`just full-cases` makes both). Cases of robots want root, ip and nft. With NAME only cases whose path has it.
set -uo pipefail
cd "$(dirname "$0")/../.."
program=$(realpath "$1") python=$(realpath --no-symlinks "$2") passed=0 failed=0
shift 2
for case in tests/cases/robots/[0-9]*.sh tests/cases/python/[0-9]*.py; do
    [ -e "$case" ] || continue
    wanted=$([ $# -eq 0 ] && echo yes)
    for name in "$@"; do [[ $case == *$name* ]] && wanted=yes; done
    [ "$wanted" ] || continue
    work=$(mktemp -d)
    case $case in
        *.sh) run=(bash "$case" "$program" "$python") ;;
        *.py) run=("$python" "$case" "$program") ;;
    esac
    # A case finds an empty folder of its own, and its own path from there.
    if said=$(CASE_WORK=$work timeout 300 "${run[@]}" 2>&1 </dev/null); then
        passed=$((passed + 1))
        echo "ok      $case"
    else
        failed=$((failed + 1))
        echo "FAILED  $case"
        sed 's/^/        /' <<<"$said" | tail -n 15
    fi
    rm -rf "$work"
done
echo "$passed passed, $failed failed"
[ "$failed" -eq 0 ] && [ "$passed" -gt 0 ]
