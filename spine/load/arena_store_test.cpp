// SPDX-License-Identifier: Apache-2.0
// The Loader with the arena: what it runs, and what it refuses to believe.
#include "spine/load/law_store.hpp"

#include <gtest/gtest.h>
#include <unistd.h>

#include <cstring>
#include <functional>
#include <memory>
#include <string>

#include "spine/law/test/slot_rig.hpp"
#include "spine/load/loader.hpp"

namespace lithe::load {
namespace {

using wire::StageResult;

struct Idle {
  struct Params {};
  struct State {
    double sum_rad = 7;
  };
  static void step(const Tick&, const Params&, State&, Effort&) {}
};
constexpr LitheLaw kIdle = describe<Idle>("idle");

// A law as lawd would have linked it for a slot: descriptor, default state, and a step that returns at once.
struct Placed {
  LitheLaw law = kIdle;
  Idle::State defaults;
#if defined(__x86_64__)
  std::array<unsigned char, 8> code = {0xc3};  // ret
#else
  std::array<unsigned char, 8> code = {0xc0, 0x03, 0x5f, 0xd6};  // ret
#endif
};

template <class Pointer>
Pointer at(std::uint64_t address) {
  return reinterpret_cast<Pointer>(address);
}

class ArenaStoreTest : public testing::Test {
 protected:
  void SetUp() override {
    Result<int> memory = arena::make_memory();
    ASSERT_TRUE(memory) << memory.message();
    fd_ = *memory;
    Result<arena::Arena> mapped = arena::Arena::attach_exec(fd_);
    if (!mapped) GTEST_SKIP() << mapped.message();
    store_ = std::make_unique<ArenaStore>(std::move(*mapped));
    loader_ = std::make_unique<Loader>(slot_, dlopen_, *spine_, *control_, rehearsal_, store_.get());
  }
  void TearDown() override { close(fd_); }

  // Writes the law into a slot, as spoilt as `spoil` makes it, and says so in the request that announces it.
  wire::StageRequest place(std::uint32_t slot, const std::function<void(Placed&, wire::StageRequest&)>& spoil = {}) {
    const std::uint64_t base = arena::is_slot(slot) ? arena::slot_address(slot) : arena::kBase;
    Placed placed;
    placed.law.step = at<decltype(placed.law.step)>(base + offsetof(Placed, code));
    placed.law.state_defaults = at<const void*>(base + offsetof(Placed, defaults));
    wire::StageRequest request;
    request.request_id = ++request_id_;
    request.slot = slot;
    request.entry = base + offsetof(Placed, law);
    request.code_bytes = sizeof placed;
    if (spoil) spoil(placed, request);
    request.image_hash = arena::image_hash(std::as_bytes(std::span(&placed, 1)));
    EXPECT_EQ(pwrite(fd_, &placed, sizeof placed, static_cast<off_t>(base - arena::kBase)),
              static_cast<ssize_t>(sizeof placed));
    auto* code = reinterpret_cast<char*>(base);
    __builtin___clear_cache(code, code + sizeof placed);  // AArch64: what arena::Writer does for lawd
    return request;
  }
  StageResult stage(const wire::StageRequest& request) { return loader_->stage(request, 1); }
  void commit() {
    ASSERT_TRUE(law::commit_next(slot_).has_value());
    while (loader_->poll(1)) {
    }
  }
  std::string told() {
    wire::Event event;
    ipc::RingReader<wire::Event, wire::spine_segment::kEventsLoaderDepth> events(spine_->events_loader);
    return events.latest(event) ? event.text.data() : "";
  }
  // A request that was refused with these words has left no trace.
  void expect_refused(const wire::StageRequest& request, StageResult result, const std::string& words) {
    EXPECT_EQ(stage(request), result) << words;
    EXPECT_NE(told().find(words), std::string::npos) << told();
    EXPECT_FALSE(law::commit_next(slot_).has_value());
  }

  int fd_ = -1;
  std::uint64_t request_id_ = 0;
  std::unique_ptr<ipc::SpineMemory> spine_ = std::make_unique<ipc::SpineMemory>();
  std::unique_ptr<ipc::ControlMemory> control_ = std::make_unique<ipc::ControlMemory>();
  law::Slot slot_;
  DlopenStore dlopen_;
  std::unique_ptr<law::Sandbox> sandbox_ = std::make_unique<law::Sandbox>();
  Rehearsal rehearsal_{*spine_, 1, 1e-3, *sandbox_};
  std::unique_ptr<ArenaStore> store_;
  std::unique_ptr<Loader> loader_;
};

TEST_F(ArenaStoreTest, PlacedLawIsStagedCommittedAndItsSlotPublished) {
  EXPECT_EQ(stage(place(5)), StageResult::staged);
  commit();
  ASSERT_NE(slot_.active(), nullptr);
  EXPECT_STREQ(slot_.active()->descriptor->name, "idle");
  EXPECT_EQ(slot_.active()->slot, 5u);
  wire::LawInfo info;
  ASSERT_TRUE(ipc::ChannelReader<wire::LawInfo>(spine_->law_info[slot_.active()->index]).read(info));
  EXPECT_EQ(info.slot, 5u);
  EXPECT_EQ(info.code_bytes, sizeof(Placed));
  double sum_rad = 0;
  std::memcpy(&sum_rad, slot_.active()->state.data(), sizeof sum_rad);
  EXPECT_EQ(sum_rad, 7) << "the defaults are read from the slot";
}

TEST_F(ArenaStoreTest, SlotThatDoesNotExistIsHostile) {
  expect_refused(place(arena::kSlots + 1), StageResult::hostile, "no such slot");
  expect_refused(place(0xffffffff), StageResult::hostile, "no such slot");
}

TEST_F(ArenaStoreTest, SlotOfAnotherResidentLawIsHostileUntilThatLawIsGone) {
  EXPECT_EQ(stage(place(3)), StageResult::staged);
  commit();
  expect_refused(place(3), StageResult::hostile, "another law in memory");
  for (std::uint32_t i = 0; i < law::kHistory + 1; ++i) {
    EXPECT_EQ(stage(place(4 + i)), StageResult::staged);
    commit();
  }
  EXPECT_EQ(stage(place(3)), StageResult::staged) << "retired, so its slot is free";
}

TEST_F(ArenaStoreTest, DescriptorOutsideTheImageIsHostile) {
  const auto with_entry = [&](std::uint64_t entry) {
    wire::StageRequest request = place(2);
    request.entry = entry;
    return request;
  };
  const std::uint64_t base = arena::slot_address(2);
  for (const std::uint64_t entry : {std::uint64_t{0}, base - 8, base + 24, base + 1, arena::slot_address(3),
                                    base + sizeof(Placed), ~std::uint64_t{7}, arena::kStubs}) {
    expect_refused(with_entry(entry), StageResult::hostile, "descriptor lies outside");
  }
}

TEST_F(ArenaStoreTest, ImageSizesThatCannotBeAreHostile) {
  for (const std::uint32_t bytes : {0u, 1u, static_cast<std::uint32_t>(sizeof(LitheLaw)) - 1}) {
    wire::StageRequest request = place(2);
    request.code_bytes = bytes;
    expect_refused(request, StageResult::hostile, "outside the image");
  }
  for (const std::uint32_t bytes : {arena::kSlotBytes + 1, 0xffffffffu}) {
    wire::StageRequest request = place(arena::kSlots);
    request.code_bytes = bytes;
    expect_refused(request, StageResult::hostile, "larger than a slot");
  }
}

TEST_F(ArenaStoreTest, EveryPointerOfTheDescriptorMustStayInItsSlot) {
  const std::uint64_t end = arena::slot_address(2) + sizeof(Placed);
  using Step = decltype(LitheLaw::step);
  for (const std::uint64_t step : {end, arena::slot_address(2) - 16, arena::slot_address(3), arena::kStubs})
    expect_refused(place(2, [&](Placed& p, auto&) { p.law.step = at<Step>(step); }), StageResult::hostile, "its step");
  expect_refused(place(2, [](Placed& p, auto&) { p.law.step = kIdle.step; }), StageResult::hostile, "its step");
  expect_refused(place(2, [&](Placed& p, auto&) { p.law.init = at<decltype(LitheLaw::init)>(end); }),
                 StageResult::hostile, "its init");
  for (const std::uint64_t defaults : {end - 4, std::uint64_t{16}, arena::slot_address(1), ~std::uint64_t{0}}) {
    expect_refused(place(2, [&](Placed& p, auto&) { p.law.state_defaults = at<const void*>(defaults); }),
                   StageResult::hostile, "State's defaults");
  }
}

TEST_F(ArenaStoreTest, ImageThatIsNotTheAnnouncedOneIsDamaged) {
  wire::StageRequest request = place(2);
  request.image_hash ^= 1;
  expect_refused(request, StageResult::image_damaged, "not hold the image");
  request = place(2);
  const char byte = 1;
  ASSERT_EQ(pwrite(fd_, &byte, 1, arena::kSlotBytes + static_cast<off_t>(sizeof(Placed)) - 1), 1);
  expect_refused(request, StageResult::image_damaged, "not hold the image");
  EXPECT_EQ(stage(place(2)), StageResult::staged) << "nothing of the refused ones stays";
}

TEST_F(ArenaStoreTest, WrongContractIsToldBeforeAnyPointerCounts) {
  expect_refused(place(2,
                       [](Placed& p, auto&) {
                         p.law.joints = kMaxJoints + 1;
                         p.law.step = nullptr;
                       }),
                 StageResult::abi_mismatch, "contract mismatch");
  EXPECT_EQ(stage(place(2)), StageResult::staged);
}

TEST_F(ArenaStoreTest, WithoutAnArenaARequestForASlotIsRefused) {
  const auto spine = std::make_unique<ipc::SpineMemory>();
  Loader plain(slot_, dlopen_, *spine, *control_, rehearsal_);
  EXPECT_EQ(plain.stage(place(1), 1), StageResult::load_failed);
}

// Sixteen slots, eight residents: as the supervisor chooses them.
TEST_F(ArenaStoreTest, ThousandPlacementsReuseTheSlotsAndKeepMemoryFlat) {
#if defined(__SANITIZE_ADDRESS__)
  GTEST_SKIP() << "the sanitizer keeps freed memory";
#endif
  const auto resident_kib = [] {
    long pages = 0, resident = 0;
    std::FILE* statm = std::fopen("/proc/self/statm", "r");
    EXPECT_EQ(std::fscanf(statm, "%ld %ld", &pages, &resident), 2);
    std::fclose(statm);
    return resident * sysconf(_SC_PAGESIZE) / 1024;
  };
  long before_kib = 0;
  for (std::uint32_t i = 0; i < 1000; ++i) {
    ASSERT_EQ(stage(place(1 + i % arena::kSlots)), StageResult::staged) << told();
    commit();
    if (i == 100) before_kib = resident_kib();
  }
  EXPECT_LE(resident_kib() - before_kib, 1024) << "KiB more after another 900 placements; a page each is 3600";
  EXPECT_EQ(slot_.active()->law_id, 1000u);
}

}  // namespace
}  // namespace lithe::load
