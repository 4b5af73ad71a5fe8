// SPDX-License-Identifier: Apache-2.0
// The Loader beside a ticking Spine: it may not allocate; only what dlopen does inside a LawStore is excused.
#include <gtest/gtest.h>

#include <cstdio>
#include <cstring>
#include <memory>

#include "spine/core/test/no_alloc_rig.hpp"
#include "spine/law/test/slot_rig.hpp"
#include "spine/load/loader.hpp"

namespace lithe::load {
namespace {

struct Wave {
  struct Params {
    Param gain_nm{1, 0, 2};
  };
  struct State {
    double phase_rad = 0;
  };
  static void step(const Tick&, const Params& p, State& s, Effort& u) {
    s.phase_rad += 0.1;
    u.torque_nm[0] = p.gain_nm * std::sin(s.phase_rad);
  }
  static void init(const History& past, const Params&, State& s) { s.phase_rad = past.count * past.dt_s; }
};
constexpr LitheLaw kWave = describe<Wave>("wave");

// A store whose only law is part of this program.
class BuiltInStore final : public LawStore {
 public:
  wire::StageResult load(std::uint32_t, const wire::StageRequest& request, const LitheLaw*& law,
                         std::span<char> why) override {
    law = &kWave;
    if (std::strcmp(request.path.data(), "/wave") == 0) return wire::StageResult::staged;
    std::snprintf(why.data(), why.size(), "there is no %s", request.path.data());
    return wire::StageResult::load_failed;
  }
  void unload(std::uint32_t) override {}
};

TEST(LoaderNoAlloc, StagingRefusingAndRetiringNeverAllocate) {
  const auto spine = std::make_unique<ipc::SpineMemory>();
  const auto control = std::make_unique<ipc::ControlMemory>();
  ipc::MailboxSender<wire::StageRequest, wire::control_segment::kStageDepth> sender(control->stage, spine->stage_ack);
  law::Slot slot;
  BuiltInStore store;
  const auto sandbox = std::make_unique<law::Sandbox>();
  Rehearsal rehearsal(*spine, 1, 1e-3, *sandbox);
  const auto loader = std::make_unique<Loader>(slot, store, *spine, *control, rehearsal);
  std::uint32_t commits = 0;
  for (std::uint64_t i = 0; i < 100; ++i) {
    wire::StageRequest request;
    request.request_id = i;
    std::strcpy(request.path.data(), i % 5 == 0 ? "/nothing" : "/wave");
    sender.send(request);
    const NoAllocScope scope;
    while (loader->poll(1)) {
    }
    if (law::commit_next(slot)) ++commits;
    if (i % 7 == 0) slot.rollback();
  }
  EXPECT_EQ(commits, 80u);
}

}  // namespace
}  // namespace lithe::load
