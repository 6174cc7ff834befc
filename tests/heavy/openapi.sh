#!/usr/bin/env bash
# schemathesis over the OpenAPI document of a throw-away server, bounded in time.
#
#     heavy/openapi.sh [seconds, default 180] [more arguments of `schemathesis run`]
#
# Not asked is whether all that fits the schema is accepted: that an image has as many bytes as its size says, no schema can
# tell. STRICT=1 asks for it all the same, to see where the document could say more (patterns, bounds, what is required).
#
# PERCEPT_BIN names the server, PERCEPT_CONFIG a configuration. schemathesis is installed into a venv of its own, named by
# SCHEMATHESIS_VENV, so that its dependencies do not meet the client's. Exits with 0 if no failure was found.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

seconds=${1:-180}
shift || true
venv=${SCHEMATHESIS_VENV:-${XDG_CACHE_HOME:-$HOME/.cache}/percept-schemathesis}
[ -x "$venv/bin/schemathesis" ] || { python3 -m venv "$venv" && "$venv/bin/pip" install --quiet 'schemathesis>=4,<5'; }

folder=$(mktemp -d)
server=
# shellcheck disable=SC2064
trap 'kill "$server" 2>/dev/null || true; wait "$server" 2>/dev/null || true; rm -rf "$folder"' EXIT
mkfifo "$folder/ready"
binary=$(realpath "${PERCEPT_BIN:-../target/release/percept}")
# schemathesis keeps what it found where it runs, and would begin with that the next time.
cd "$folder"
"$binary" serve --data-dir "$folder/data" --grpc 127.0.0.1:0 --rest 127.0.0.1:0 --zenoh '' \
  >"$folder/ready" 2>"$folder/log" &
server=$!
read -r ready <"$folder/ready"
rest=$(sed -E 's/.*"rest":"([^"]+)".*/\1/' <<<"$ready")

# Sessions of the examples: what is asked for exists now and then.
for id in 0 a robot; do
  curl -sf -o /dev/null -H 'content-type: application/json' -d "{\"session_id\": \"$id\"}" "http://$rest/v1/sessions"
done

exclude=(--exclude-checks positive_data_acceptance)
[ -z "${STRICT:-}" ] || exclude=()
status=0
# An event stream does not end by itself.
timeout --signal=INT "$((seconds + 30))" "$venv/bin/schemathesis" run "http://$rest/openapi.json" \
  --url "http://$rest" \
  --exclude-path '/v1/sessions/{session_id}/events' \
  --max-time "$seconds" --workers 1 --request-timeout 20 --seed 1 --continue-on-failure --no-color \
  "${exclude[@]}" "$@" || status=$?
if ! kill -0 "$server" 2>/dev/null; then
  echo "the server has died; its log:"
  tail -20 "$folder/log"
  exit 1
fi
echo "panics in the log: $(grep -c panicked "$folder/log" || true); resident: $(awk '/VmHWM/ {print $2, $3}' "/proc/$server/status") at most"
exit "$status"
