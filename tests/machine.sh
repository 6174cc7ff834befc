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
