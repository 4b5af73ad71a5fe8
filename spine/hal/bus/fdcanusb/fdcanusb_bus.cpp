// SPDX-License-Identifier: Apache-2.0
#include "spine/hal/bus/fdcanusb/fdcanusb_bus.hpp"

#include <algorithm>
#include <array>
#include <span>
#include <string_view>

#include "spine/hal/bus/fdcanusb/fdcanusb_codec.hpp"
#include "spine/hal/bus/serial/words.hpp"

namespace lithe::hal {
namespace {

constexpr std::int64_t kSilenceNs = 500'000'000;
constexpr std::uint64_t kSilenceFrames = 256;  // more than a scan for devices sends, to which most ids do not answer
// Time in which the adapter discards all frames that are not acknowledged: three frames in 50 ms.
constexpr std::int64_t kAskEveryNs = 600'000'000;

// Adds the line end, and a checksum when it is enabled.
std::size_t finish(std::string_view text, bool with_sum, std::span<char> out) LITHE_RT {
  std::size_t size = std::min(text.size(), out.size() - 1);
  std::copy_n(text.data(), size, out.data());
  if (with_sum) size = fdcanusb::append_sum(out.first(out.size() - 1), size);
  out[size] = '\n';
  return size + 1;
}

std::string finished(std::string_view text, bool with_sum) {
  std::array<char, fdcanusb::kLongestLine> line{};
  return {line.data(), finish(text, with_sum, line)};
}

}  // namespace

FdcanusbBus::FdcanusbBus(const FdcanusbParams& params)
    : TextBus(SerialPort(params.path, params.baud, params.sys), params.reply_wait_ns, '\n', '\r'),
      checksums_(params.checksums) {}

// The first line must be harmless behind a partial command of an earlier program: wherever that was cut, the partial
// command plus "can on" is never a valid command, for an adapter and for a drive on a UART. An empty line would not be
// safe: it could complete the partial command and move a motor. A drive on a UART refuses both, and counts two errors.
Result<std::unique_ptr<FdcanusbBus>> FdcanusbBus::open(const FdcanusbParams& params) {
  std::unique_ptr<FdcanusbBus> bus(new FdcanusbBus(params));
  if (const Result<> opened = bus->TextBus::open(); !opened) return opened.error();
  bus->forget();
  return bus;
}

std::string FdcanusbBus::greeting() const {
  const bool sums = begins_with_sums();
  return finished("can on", sums) + finished("conf set can.autorecover 1", sums);
}

bool FdcanusbBus::begins_with_sums() const LITHE_RT {
  return checksums_ == Checksums::on || (checksums_ == Checksums::by_device && !adapter().fdcanusb);
}

void FdcanusbBus::begin(std::int64_t now_ns) LITHE_RT {
  TextBus::begin(now_ns);
  mute(!exchange_is_due(now_ns));
}

// Sends always while answers come.
bool FdcanusbBus::exchange_is_due(std::int64_t now_ns) LITHE_RT {
  if (!begun_ || statistics_.received != heard_) {
    begun_ = true;
    heard_ = statistics_.received;
    sent_ = statistics_.sent;
    heard_ns_ = now_ns;
    bus_off_.store(false, std::memory_order_relaxed);
    return true;
  }
  if (now_ns - heard_ns_ < kSilenceNs) return true;
  const bool few = statistics_.sent - sent_ < kSilenceFrames;
  if (now_ns - asked_ns_ < kAskEveryNs) return few;
  asked_ns_ = now_ns;
  std::array<char, fdcanusb::kLongestLine> line;
  add({line.data(), finish("can status", with_sums_, line)});
  return few || !bus_off_.load(std::memory_order_relaxed);
}

void FdcanusbBus::forget() LITHE_RT {
  with_sums_ = begins_with_sums();
  begun_ = false;
  bus_off_.store(false, std::memory_order_relaxed);
}

void FdcanusbBus::note_state(std::string_view status) LITHE_RT {
  const bool off = status.find("busoff=1") != std::string_view::npos;
  if (off && !bus_off_.load(std::memory_order_relaxed)) ++statistics_.errors;
  bus_off_.store(off, std::memory_order_relaxed);
}

std::string FdcanusbBus::why_down() const {
  const std::string why = TextBus::why_down();
  if (!why.empty() || !bus_off_.load(std::memory_order_relaxed)) return why;
  return path() +
         ": bus-off, the adapter's controller saw too many errors; check wires, termination and bit rates; it " +
         "comes back by itself";
}

std::size_t FdcanusbBus::format(const Frame& frame, std::span<char> out) LITHE_RT {
  return fdcanusb::format_send(frame, with_sums_, out);
}

TextBus::Said FdcanusbBus::parse(std::string_view line, Frame& frame) LITHE_RT {
  line.remove_suffix(1);
  if (line.empty()) return Said::between_lines;
  fdcanusb::Line said;
  if (!fdcanusb::parse_line(line, with_sums_, said)) return Said::malformed;
  const bool demanded =
      said.kind == fdcanusb::Line::Kind::error && said.text.find("checksum") != std::string_view::npos;
  if (checksums_ != Checksums::off && (demanded || said.sum == fdcanusb::Sum::right)) with_sums_ = true;
  if (said.kind == fdcanusb::Line::Kind::received) {
    frame = said.frame;
    return Said::frame;
  }
  if (said.kind == fdcanusb::Line::Kind::ok) return Said::acknowledged;
  if (said.kind == fdcanusb::Line::Kind::error) return said.text == "already in BusOn" ? Said::nothing : Said::refused;
  if (begins(said.text, "lec=")) note_state(said.text);
  return Said::nothing;
}

}  // namespace lithe::hal
