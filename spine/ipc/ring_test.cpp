// SPDX-License-Identifier: Apache-2.0
#include "spine/ipc/ring.hpp"

#include <gtest/gtest.h>

#include <atomic>
#include <chrono>
#include <memory>
#include <random>
#include <thread>

#include "spine/ipc/test/halfway_rig.hpp"

namespace lithe::ipc {
namespace {

using test::Halfway;
using test::Shared;

// All words are equal, unless it is torn.
struct Even {
  std::uint64_t word[16];

  static Even of(std::uint64_t number) {
    Even value;
    for (std::uint64_t& w : value.word) w = number;
    return value;
  }
  bool whole() const {
    for (const std::uint64_t w : word)
      if (w != word[0]) return false;
    return true;
  }
};
constexpr std::size_t kDepth = 8;
using Memory = RingMemory<Even, kDepth>;

void push(Memory& memory, std::uint64_t from, std::uint64_t to) {
  RingWriter<Even, kDepth> writer(memory);
  for (std::uint64_t i = from; i <= to; ++i) writer.push(Even::of(i));
}

TEST(Ring, ReaderGetsEveryRecordInOrder) {
  auto memory = std::make_unique<Memory>();
  RingReader<Even, kDepth> reader(*memory);
  Even record{};
  EXPECT_FALSE(reader.next(record));
  for (std::uint64_t i = 1; i <= 50; ++i) {
    push(*memory, i, i);
    ASSERT_TRUE(reader.next(record));
    EXPECT_EQ(record.word[0], i);
  }
  EXPECT_TRUE(reader.empty());
  EXPECT_EQ(reader.lost(), 0u);
}

TEST(Ring, SlowReaderLearnsHowMuchItLost) {
  auto memory = std::make_unique<Memory>();
  RingReader<Even, kDepth> reader(*memory);
  push(*memory, 1, 20);
  Even record{};
  for (std::uint64_t i = 13; i <= 20; ++i) {
    ASSERT_TRUE(reader.next(record));
    EXPECT_EQ(record.word[0], i);
  }
  EXPECT_FALSE(reader.next(record));
  EXPECT_EQ(reader.lost(), 12u);
}

TEST(Ring, NewReaderStartsAtTheEndAndMayGoBack) {
  auto memory = std::make_unique<Memory>();
  push(*memory, 1, 20);
  RingReader<Even, kDepth> reader(*memory);
  Even record{};
  EXPECT_FALSE(reader.next(record));
  reader.rewind();
  ASSERT_TRUE(reader.next(record));
  EXPECT_EQ(record.word[0], 13u);
  EXPECT_EQ(reader.lost(), 0u);
  reader.rewind(3);
  ASSERT_TRUE(reader.next(record));
  EXPECT_EQ(record.word[0], 18u);
}

TEST(Ring, LatestIsTheNewestWhateverTheCursor) {
  auto memory = std::make_unique<Memory>();
  const RingReader<Even, kDepth> reader(*memory);
  Even record{};
  EXPECT_FALSE(reader.latest(record));
  push(*memory, 1, 11);
  ASSERT_TRUE(reader.latest(record));
  EXPECT_EQ(record.word[0], 11u);
}

TEST(Ring, WriterCopiesOnlyTheWordsInUse) {
  auto memory = std::make_unique<Memory>();
  wire::WordRanges used;
  used.add(0, 8);
  used.add(4 * 8, 6 * 8);
  RingWriter<Even, kDepth>(*memory).push(Even::of(3), used);
  Even record{};
  ASSERT_TRUE((RingReader<Even, kDepth>(*memory).latest(record)));
  for (std::size_t i = 0; i < 16; ++i) EXPECT_EQ(record.word[i], i == 0 || i == 4 || i == 5 ? 3u : 0u) << "word " << i;
}

TEST(Ring, RecordOverwrittenUnderACopyCountsAsLost) {
  auto memory = std::make_unique<Memory>();
  RingReader<Even, kDepth> reader(*memory);
  push(*memory, 1, 1);
  Halfway<Even> copy;
  copy.arm([&] { push(*memory, 2, 9); });  // 9 has the slot of 1
  EXPECT_FALSE(reader.next(*copy));
  ASSERT_TRUE(copy.fired());
  EXPECT_EQ(reader.lost(), 1u);
  Even record{};
  ASSERT_TRUE(reader.next(record));
  EXPECT_EQ(record.word[0], 2u);
}

// The broken twin of Record::read: checks the sequence only before the copy.
bool read_without_recheck(const Record<Even>& record, std::uint64_t count, Even& value) {
  if (load_word(record.sequence, std::memory_order_acquire) != 2 * count) return false;
  for (std::size_t i = 0; i < 16; ++i) value.word[i] = load_word(record.words[i], std::memory_order_relaxed);
  return true;
}

TEST(Ring, TwinWithoutTheSecondLookAcceptsATornRecord) {
  auto memory = std::make_unique<Memory>();
  push(*memory, 1, 1);
  Halfway<Even> copy;
  copy.arm([&] { push(*memory, 2, 9); });
  ASSERT_TRUE(read_without_recheck(memory->slots[0].record, 1, *copy));
  EXPECT_FALSE((*copy).whole());
}

TEST(Ring, WriterKilledInMidRecordLeavesTheRestReadable) {
  Shared<Memory> memory;
  push(*memory, 1, 3);
  RingReader<Even, kDepth> reader(*memory);
  test::in_child([&memory] {
    Halfway<Even> four(Even::of(4));
    four.arm(test::kill_self);
    RingWriter<Even, kDepth>(*memory).push(*four);
  });
  Even record{};
  EXPECT_FALSE(reader.next(record)) << "an incomplete record was announced";
  ASSERT_TRUE(reader.latest(record));
  EXPECT_EQ(record.word[0], 3u);
  push(*memory, 44, 44);
  ASSERT_TRUE(reader.next(record));
  EXPECT_TRUE(record.whole());
  EXPECT_EQ(record.word[0], 44u);
  EXPECT_EQ(reader.lost(), 0u);
}

// The broken twin of RingWriter::push: announces the record before it is written.
TEST(Ring, TwinThatAnnouncesFirstLosesTheRecord) {
  auto memory = std::make_unique<Memory>();
  RingReader<Even, kDepth> reader(*memory);
  Halfway<Even> record(Even::of(1));
  Even seen{};
  record.arm([&] { EXPECT_FALSE(reader.next(seen)); });
  store_word(memory->head, 1, std::memory_order_release);
  memory->slots[0].record.write(1, *record, all_words<Even>());
  EXPECT_EQ(reader.lost(), 1u);

  auto good = std::make_unique<Memory>();
  RingReader<Even, kDepth> patient(*good);
  Halfway<Even> again(Even::of(1));
  again.arm([&] { EXPECT_FALSE(patient.next(seen)); });
  RingWriter<Even, kDepth>(*good).push(*again);
  EXPECT_EQ(patient.lost(), 0u);
  EXPECT_TRUE(patient.next(seen));
}

TEST(Ring, ReadersNeverSeeTornRecordsAndAccountForEveryOne) {
  auto memory = std::make_unique<Memory>();
  constexpr std::uint64_t kRecords = 200'000;
  std::atomic<bool> done{false};
  std::atomic<int> ready{0};
  const auto watch = [&] {
    RingReader<Even, kDepth> reader(*memory);
    ready.fetch_add(1);
    Even record{};
    std::uint64_t last = 0;
    std::uint64_t got = 0;
    while (!done.load() || !reader.empty()) {
      if (!reader.next(record)) continue;
      ++got;
      if (!record.whole() || record.word[0] <= last) {
        ADD_FAILURE() << "after " << last << " came " << record.word[0] << (record.whole() ? "" : ", torn");
        return;
      }
      last = record.word[0];
    }
    EXPECT_EQ(got + reader.lost(), kRecords);
    EXPECT_EQ(last, kRecords);
  };
  std::thread first(watch);
  std::thread second(watch);
  while (ready.load() < 2) std::this_thread::yield();
  push(*memory, 1, kRecords);
  done = true;
  first.join();
  second.join();
}

TEST(Ring, WriterProcessesKilledAtRandomMomentsNeverTear) {
  Shared<Memory> memory;
  RingReader<Even, kDepth> reader(*memory);
  std::mt19937 random(2);
  Even record{};
  for (int round = 0; round < 100; ++round) {
    const pid_t writer = test::start_child([&memory] {
      for (std::uint64_t i = load_word(memory->head, std::memory_order_relaxed) + 1;; ++i) push(*memory, i, i);
    });
    const std::uint64_t before = load_word(memory->head, std::memory_order_acquire);
    const auto pause = std::chrono::microseconds(std::uniform_int_distribution(0, 300)(random));
    for (auto end = std::chrono::steady_clock::now() + pause;
         load_word(memory->head, std::memory_order_acquire) == before || std::chrono::steady_clock::now() < end;) {
      if (reader.next(record)) ASSERT_TRUE(record.whole()) << "round " << round;
    }
    kill(writer, SIGKILL);
    waitpid(writer, nullptr, 0);
  }
}

}  // namespace
}  // namespace lithe::ipc
