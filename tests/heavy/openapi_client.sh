#!/usr/bin/env bash
# Generates a TypeScript client from the OpenAPI document of a throw-away server, compiles it strictly with a small program,
# and lets that program ask the server.
#
#     heavy/openapi_client.sh
#
# PERCEPT_BIN names the server. Needs Node and npm; the generator and the compiler go into a folder of their own, named by
# OPENAPI_CLIENT_CACHE. Exits with 0 if everything compiled and was answered as it should be.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

cache=${OPENAPI_CLIENT_CACHE:-${XDG_CACHE_HOME:-$HOME/.cache}/percept-openapi-client}
if [ ! -x "$cache/node_modules/.bin/openapi-typescript" ]; then
  mkdir -p "$cache"
  npm install --silent --no-audit --no-fund --prefix "$cache" \
    openapi-typescript@7.13.0 openapi-fetch@0.17.0 typescript@5.9 @types/node@20
fi

folder=$(mktemp -d)
server=
# shellcheck disable=SC2064
trap 'kill "$server" 2>/dev/null || true; wait "$server" 2>/dev/null || true; rm -rf "$folder"' EXIT
mkfifo "$folder/ready"
binary=$(realpath "${PERCEPT_BIN:-../target/release/percept}")
"$binary" serve --data-dir "$folder/data" --grpc 127.0.0.1:0 --rest 127.0.0.1:0 --zenoh '' \
  >"$folder/ready" 2>"$folder/log" &
server=$!
read -r ready <"$folder/ready"
rest=http://$(sed -E 's/.*"rest":"([^"]+)".*/\1/' <<<"$ready")

ln -s "$cache/node_modules" "$folder/node_modules"
cp heavy/openapi_client/main.ts "$folder"
cd "$folder"
echo '{"type": "module"}' >package.json
curl -sf "$rest/openapi.json" -o openapi.json
node_modules/.bin/openapi-typescript openapi.json --output api.d.ts
node_modules/.bin/tsc --strict --noUncheckedIndexedAccess --module nodenext --target es2022 --types node main.ts
node main.js "$rest"
echo "generated from $(grep -c '"operationId"' <<<"$(tr ',' '\n' <openapi.json)") operations, compiled, answered"
