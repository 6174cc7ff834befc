# What a bare Debian or Ubuntu lacks; sourced by tests/run and .ci/run.

# Installs Debian packages if we may, else says what to do.
install() {
  if [ "$(id -u)" != 0 ] || ! command -v apt-get >/dev/null; then
    echo "please install first: apt-get install $*" >&2
    return 1
  fi
  echo "installing $*"
  export DEBIAN_FRONTEND=noninteractive
  { apt-get -qq update && apt-get -qq install --no-install-recommends "$@"; } >/dev/null
}

need_compiler() {
  command -v cc >/dev/null || install gcc libc6-dev
  command -v make >/dev/null || install make
  if ! command -v cargo >/dev/null; then
    [ -x "$HOME/.cargo/bin/cargo" ] || { echo "please install Rust first: https://rustup.rs" >&2; return 1; }
    export PATH="$HOME/.cargo/bin:$PATH"
  fi
}

need_venv() {
  command -v python3 >/dev/null || install python3 python3-venv
  python3 -c 'import ensurepip' 2>/dev/null || install python3-venv
  python3 -c 'import sys; sys.exit(sys.version_info < (3, 10))' || { echo "please install Python 3.10 or later" >&2; return 1; }
}

# Prometheus and promtool, unpacked below folder $1 from Debian's package: 19 MB, nothing installed. Without them the tests
# that ask them are skipped and say so.
need_prometheus() {
  command -v promtool >/dev/null && return
  export PROMETHEUS_DIR=${PROMETHEUS_DIR:-$1/prometheus/usr/bin}
  [ -x "$PROMETHEUS_DIR/promtool" ] && return
  command -v apt-get >/dev/null && command -v dpkg >/dev/null || { unset PROMETHEUS_DIR; return 0; }
  mkdir -p "$1/prometheus"
  (cd "$1/prometheus" && { apt-get -qq download prometheus || { apt-get -qq update && apt-get -qq download prometheus; }; } \
    && dpkg -x prometheus_*.deb . && rm -f prometheus_*.deb) >/dev/null 2>&1 \
    || { echo "no Prometheus could be had: its tests are skipped" >&2; unset PROMETHEUS_DIR; }
}
