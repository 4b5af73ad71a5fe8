// SPDX-License-Identifier: Apache-2.0
#include "trial/sections/law_harness.hpp"

#include <fenv.h>
#include <sys/mman.h>
#include <unistd.h>

#include <algorithm>
#include <cstdlib>
#include <cstring>

#include "spine/core/host/fd.hpp"
#include "spine/law/arithmetic.hpp"

namespace lithe::trial {
namespace {

constexpr std::byte kPattern{0xA5};

// Maps `inside` bytes with an inaccessible page on either side.
std::byte* reserve(std::size_t inside, std::size_t page) {
  void* at = mmap(nullptr, inside + 2 * page, PROT_NONE, MAP_PRIVATE | MAP_ANONYMOUS | MAP_NORESERVE, -1, 0);
  if (at == MAP_FAILED) std::abort();
  return static_cast<std::byte*>(at) + page;
}

void map_over(std::byte* at, std::size_t inside, int sharing) {
  const int flags = MAP_FIXED | MAP_POPULATE | MAP_ANONYMOUS | sharing;
  if (mmap(at, inside, PROT_READ | PROT_WRITE, flags, -1, 0) == MAP_FAILED) std::abort();
}

// Both views of a file in memory: where mremap gives no second view (qemu-user).
void view_of_file(std::byte* at, std::byte* pages, std::size_t inside) {
  const Fd file(memfd_create("lithe-law", MFD_CLOEXEC));
  if (!file || ftruncate(file.get(), static_cast<off_t>(inside)) != 0) std::abort();
  for (std::byte* view : {at, pages}) {
    constexpr int kFlags = MAP_SHARED | MAP_FIXED;
    if (mmap(view, inside, PROT_READ | PROT_WRITE, kFlags, file.get(), 0) == MAP_FAILED) std::abort();
  }
}

// The same pages once more, read-only. Of a shared mapping, an old size of 0 asks for a second view.
void view_over(std::byte* at, std::byte* pages, std::size_t inside, std::size_t page) {
  if (mremap(pages, 0, inside, MREMAP_MAYMOVE | MREMAP_FIXED, at) == MAP_FAILED) view_of_file(at, pages, inside);
  if (mprotect(at, inside, PROT_READ) != 0) std::abort();
  for (std::size_t i = 0; i < inside; i += page) (void)*const_cast<volatile std::byte*>(at + i);  // no fault in a step
}

}  // namespace

Guarded::Guarded(std::size_t bytes, Kind kind) : size_(bytes) {
  const auto page = static_cast<std::size_t>(sysconf(_SC_PAGESIZE));
  const std::size_t inside = std::max<std::size_t>(1, (bytes + page - 1) / page) * page;
  const bool two = kind == Kind::with_read_only_view;
  std::byte* ours = reserve(inside, page);
  map_over(ours, inside, two ? MAP_SHARED : MAP_PRIVATE);
  std::byte* theirs = ours;
  if (two) {
    theirs = reserve(inside, page);
    view_over(theirs, ours, inside, page);
  }
  data_ = ours + inside - bytes;
  law_view_ = theirs + inside - bytes;
  fence_ = {ours, inside - bytes};
  std::fill(fence_.begin(), fence_.end(), kPattern);
}

bool Guarded::fence_intact() const {
  if (fence_.empty()) return true;
  // Compares each byte with the one before it: as fast as memcmp, because it runs after every step.
  return fence_[0] == kPattern && std::memcmp(fence_.data(), fence_.data() + 1, fence_.size() - 1) == 0;
}

LawHarness::LawHarness(const LitheLaw& law, std::span<const Param> params, const History& past, const RawClock& clock)
    : law_(law),
      clock_(clock),
      tick_(sizeof(Tick), Guarded::Kind::with_read_only_view),
      params_(params.size_bytes(), Guarded::Kind::with_read_only_view),
      state_(law.state_size, Guarded::Kind::plain),
      effort_(sizeof(Effort), Guarded::Kind::plain),
      probes_(law.probe_count * sizeof(double), Guarded::Kind::plain),
      past_(past.count * sizeof(PastTick), Guarded::Kind::with_read_only_view),
      before_(law.state_size) {
  new (tick_.data()) Tick;
  new (effort_.data()) Effort;
  if (!params.empty()) std::memcpy(params_.data(), params.data(), params.size_bytes());
  if (past.count > 0) std::memcpy(past_.data(), past.ticks, past.count * sizeof(PastTick));
  history_ = {reinterpret_cast<const PastTick*>(past_.law_view()), past.count, past.joints, past.dt_s};
}

void LawHarness::reset(bool with_past) {
  if (law_.state_size > 0) std::memcpy(state_.data(), law_.state_defaults, law_.state_size);
  if (law_.init == nullptr) return;
  const History nothing{history_.ticks + history_.count, 0, history_.joints, history_.dt_s};
  law::with_law_arithmetic(
      [&]() LITHE_RT { law_.init(with_past ? &history_ : &nothing, params_.law_view(), state_.data()); });
}

double LawHarness::step(const Tick& in) LITHE_RT {
  std::memcpy(tick_.data(), &in, sizeof in);
  if (!before_.empty()) std::memcpy(before_.data(), state_.data(), before_.size());
  auto* effort = reinterpret_cast<Effort*>(effort_.data());
  auto* probes = reinterpret_cast<double*>(probes_.data());
  effort->clear(kMaxJoints);
  std::fill_n(probes, law_.probe_count, 0.0);
  const std::int64_t from_ns = clock_.now_ns();
  law::with_law_arithmetic([&]() LITHE_RT {
    law_.step(reinterpret_cast<const Tick*>(tick_.law_view()), params_.law_view(), state_.data(), effort, probes);
  });
  return static_cast<double>(clock_.now_ns() - from_ns);
}

void LawHarness::repeat(bool trap) {
  if (!before_.empty()) std::memcpy(state_.data(), before_.data(), before_.size());
  Tick again;
  std::memcpy(&again, tick_.data(), sizeof again);
  feclearexcept(FE_ALL_EXCEPT);
  if (trap) feenableexcept(FE_INVALID | FE_DIVBYZERO);
  step(again);
  if (trap) fedisableexcept(FE_ALL_EXCEPT);
}

const std::array<double, kMaxProbes>& LawHarness::probes() {
  std::memcpy(probe_values_.data(), probes_.data(), law_.probe_count * sizeof(double));
  return probe_values_;
}

const char* LawHarness::damage() const {
  if (!state_.fence_intact()) return "it wrote before the beginning of its State";
  if (!effort_.fence_intact()) return "it wrote before the beginning of its Effort";
  if (!probes_.fence_intact()) return "it wrote before the beginning of its Probes";
  return "";
}

}  // namespace lithe::trial
