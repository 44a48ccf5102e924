#!/bin/sh
# What `cargo run` does with the firmware that it built for the chip: flash it, start it, show its log until Ctrl-C.
if ! command -v probe-rs >/dev/null; then
  cat >&2 <<'END'
error: `probe-rs` is missing, which talks to the debug probe; get it by one of
  curl -LsSf https://github.com/probe-rs/probe-rs/releases/latest/download/probe-rs-tools-installer.sh | sh
  cargo install probe-rs-tools --locked
END
  exit 1
fi
exec probe-rs run --chip STM32F405RGTx "$@"
