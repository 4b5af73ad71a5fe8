// SPDX-License-Identifier: Apache-2.0
#include "sim/end.hpp"

#include <fcntl.h>
#include <poll.h>
#include <stdlib.h>
#include <termios.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <cstring>
#include <filesystem>
#include <span>
#include <utility>

#include "spine/hal/bus/socketcan/socketcan_codec.hpp"

namespace lithe::simulator {
namespace {

constexpr std::size_t kMostPending = 1 << 16;  // a reader this late loses output, as on a full USB pipe

bool is_end(char c) { return c == '\r' || c == '\n' || c == '\a'; }

Error failure(const std::string& what) { return Error{what + ": " + std::strerror(errno)}; }

// Raw bytes in both directions, without echo.
Result<> make_raw(const std::string& path) {
  const hal::Descriptor slave(::open(path.c_str(), O_RDWR | O_NOCTTY | O_CLOEXEC));
  if (!slave.is_open()) return failure("cannot open " + path);
  termios modes{};
  if (::tcgetattr(slave.get(), &modes) != 0) return failure("cannot read the modes of " + path);
  ::cfmakeraw(&modes);
  if (::tcsetattr(slave.get(), TCSANOW, &modes) != 0) return failure("cannot set the modes of " + path);
  return done();
}

// Atomic: the link always leads to the old or the new terminal.
Result<> point(const std::string& link, const std::string& at) {
  std::error_code wrong;
  if (std::filesystem::exists(std::filesystem::symlink_status(link, wrong)) &&
      !std::filesystem::is_symlink(link, wrong)) {
    return Error{link + " is in the way: it is no link, so it is not ours to replace; move it, or name another folder"};
  }
  const std::filesystem::path fresh = link + ".new";
  std::filesystem::remove(fresh, wrong);
  std::filesystem::create_symlink(at, fresh, wrong);
  if (!wrong) std::filesystem::rename(fresh, link, wrong);
  if (wrong) return Error{"cannot make the link " + link + ": " + wrong.message() + "; name another folder"};
  return done();
}

}  // namespace

Result<std::unique_ptr<PtyEnd>> PtyEnd::open(std::unique_ptr<hal::sim::SimAdapter> adapter, std::string link) {
  std::unique_ptr<PtyEnd> end(new PtyEnd(std::move(adapter), std::move(link)));
  if (Result<> plugged = end->plug(); !plugged) return plugged.error();
  return end;
}

PtyEnd::~PtyEnd() { remove_link(); }

// Removes the link only while it is ours: the kernel reuses the name of a closed terminal (for a shell, for example),
// and another program may have made a new link.
void PtyEnd::remove_link() {
  std::error_code none;
  const std::filesystem::path at = std::filesystem::read_symlink(link_, none);
  if (!none && !slave_path_.empty() && at == slave_path_) std::filesystem::remove(link_, none);
}

Result<> PtyEnd::plug() {
  hal::Descriptor master(::posix_openpt(O_RDWR | O_NOCTTY | O_NONBLOCK | O_CLOEXEC));
  std::array<char, 128> path{};
  if (!master.is_open() || ::grantpt(master.get()) != 0 || ::unlockpt(master.get()) != 0 ||
      ::ptsname_r(master.get(), path.data(), path.size()) != 0) {
    return failure("cannot make a pseudo terminal");
  }
  if (Result<> raw = make_raw(path.data()); !raw) return raw;
  if (Result<> pointed = link_.empty() ? done() : point(link_, path.data()); !pointed) return pointed;
  slave_path_ = path.data();
  master_ = std::move(master);
  adapter_->reset();
  return done();
}

bool PtyEnd::unplug(std::int64_t until_ns) {
  leave();
  remove_link();  // before the terminal is closed and its name is free
  master_.close();
  slave_path_.clear();
  plug_at_ns_ = until_ns;
  return true;
}

void PtyEnd::leave() {
  somebody_ = half_told_ = false;
  out_.clear();
}

// A terminal that no program has open always reports a hang-up, so it is polled rarely.
void PtyEnd::look_for_somebody() {
  pollfd ask{master_.get(), 0, 0};
  if (::poll(&ask, 1, 0) < 0 || (ask.revents & POLLHUP) != 0) return;
  somebody_ = true;
  adapter_->reset();
}

void PtyEnd::serve(std::int64_t now_ns) {
  constexpr int kMostReads = 16;  // then the other ends are served
  std::array<char, 4096> bytes{};
  for (int i = 0; i < kMostReads; ++i) {
    const hal::Moved moved = master_.read(std::as_writable_bytes(std::span(bytes)));
    if (moved.bytes > 0) {
      adapter_->feed(std::span(bytes).first(moved.bytes), now_ns, out_);
      write_out();
      continue;
    }
    if (moved.error != 0) leave();
    break;
  }
  write_out();
}

void PtyEnd::tick(std::int64_t now_ns) {
  // A failed plug-in is tried again in the next tick: terminals may be used up for a while.
  if (!master_.is_open() && (now_ns < plug_at_ns_ || !plug())) return;
  if (!somebody_) look_for_somebody();
  adapter_->idle(now_ns, out_);
  somebody_ ? write_out() : out_.clear();
}

void PtyEnd::write_out() {
  while (!out_.empty()) {
    const hal::Moved moved = master_.write(std::as_bytes(std::span(out_)));
    if (moved.bytes == 0) break;
    half_told_ = !is_end(out_[moved.bytes - 1]);
    out_.erase(0, moved.bytes);
  }
  if (out_.size() <= kMostPending) return;
  // Only whole lines are dropped: a partly written line is still finished.
  std::size_t rest = 0;
  if (half_told_) {
    while (rest < out_.size() && !is_end(out_[rest])) ++rest;
    if (rest < out_.size()) ++rest;
  }
  while (rest < out_.size() && out_[rest] == '\n') ++rest;  // part of the previous line end
  out_.resize(rest);
}

Result<std::unique_ptr<CanEnd>> CanEnd::open(const hal::SocketCanParams& params, hal::sim::SimWire& wire) {
  Result<hal::Descriptor> socket = hal::open_can_socket(params);
  if (!socket) return socket.error();
  return std::unique_ptr<CanEnd>(new CanEnd(params, wire, std::move(*socket)));
}

void CanEnd::serve(std::int64_t now_ns) {
  constexpr int kMostReads = 64;  // then the other ends are served
  for (int i = 0; i < kMostReads; ++i) {
    canfd_frame raw{};
    const hal::Moved moved = socket_.read(std::as_writable_bytes(std::span(&raw, 1)));
    if (moved.error != 0) socket_.close();
    if (moved.bytes == 0) return;
    hal::Frame frame;
    const auto bytes = std::as_bytes(std::span(&raw, 1)).first(moved.bytes);
    if (hal::socketcan::decode(bytes, frame) != hal::socketcan::Kind::frame) continue;
    wire_.on_frame(frame, now_ns, answers_);
    pass_on();
  }
}

void CanEnd::tick(std::int64_t now_ns) {
  constexpr std::int64_t kLookEveryNs = 1'000'000'000;
  if (!socket_.is_open() && now_ns >= look_at_ns_) {
    look_at_ns_ = now_ns + kLookEveryNs;
    if (Result<hal::Descriptor> found = hal::open_can_socket(params_); found) socket_ = std::move(*found);
  }
  wire_.on_time(now_ns, answers_);
  pass_on();
}

void CanEnd::pass_on() {
  for (; answers_.front() != nullptr; answers_.pop()) {
    canfd_frame raw{};
    const std::size_t size = hal::socketcan::encode(*answers_.front(), raw);
    // A frame without room in the interface is lost, as with a controller whose queue is full.
    if (size > 0 && socket_.is_open()) socket_.write(std::as_bytes(std::span(&raw, 1)).first(size));
  }
}

}  // namespace lithe::simulator
