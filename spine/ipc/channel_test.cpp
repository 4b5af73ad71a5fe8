// SPDX-License-Identifier: Apache-2.0
#include "spine/ipc/channel.hpp"

#include <gtest/gtest.h>

#include <chrono>
#include <memory>
#include <random>
#include <thread>

#include "spine/ipc/test/halfway_rig.hpp"

namespace lithe::ipc {
namespace {

using test::Halfway;
using test::Shared;

// A value whose words are all equal, unless it is torn.
struct Even {
  std::uint64_t word[32];

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
using Memory = ChannelMemory<Even>;

// Writes 2, 3, 4 and then value 5, which has the slot of value 1, and dies in the middle of it.
void die_in_value_five(Memory& memory) {
  test::in_child([&memory] {
    ChannelWriter<Even> writer(memory);
    for (std::uint64_t i = 2; i <= 4; ++i) writer.write(Even::of(i));
    Halfway<Even> five(Even::of(5));
    five.arm(test::kill_self);
    writer.write(*five);
  });
}

TEST(Channel, ReaderGetsEachValueOnceAndOnlyTheNewest) {
  auto memory = std::make_unique<Memory>();
  ChannelWriter<Even> writer(*memory);
  ChannelReader<Even> reader(*memory);
  Even value{};
  EXPECT_FALSE(reader.read(value)) << "nothing was written yet";
  writer.write(Even::of(7));
  writer.write(Even::of(8));
  ASSERT_TRUE(reader.read(value));
  EXPECT_EQ(value.word[0], 8u);
  EXPECT_EQ(reader.seen(), 2u);
  EXPECT_FALSE(reader.read(value));
  EXPECT_EQ(reader.failures(), 0u);
}

TEST(Channel, AValueOfWhichOnlySomeWordsAreUsedLeavesTheOthers) {
  auto memory = std::make_unique<Memory>();
  ChannelWriter<Even> writer(*memory);
  ChannelReader<Even> reader(*memory);
  writer.write(Even::of(7));
  wire::WordRanges used;
  used.add(0, 20);                                                         // widened to three words
  for (std::uint64_t i = 2; i <= 5; ++i) writer.write(Even::of(i), used);  // value 5 has the slot of value 1
  Even value{};
  ASSERT_TRUE(reader.read(value));
  EXPECT_EQ(value.word[0], 5u);
  EXPECT_EQ(value.word[2], 5u);
  EXPECT_EQ(value.word[3], 7u) << "of value 1";
}

TEST(Channel, WriterThatOvertakesACopyIsNoticedAndTheNewestIsRead) {
  auto memory = std::make_unique<Memory>();
  ChannelWriter<Even> writer(*memory);
  ChannelReader<Even> reader(*memory);
  writer.write(Even::of(1));
  Halfway<Even> copy;
  copy.arm([&] {
    for (std::uint64_t i = 2; i <= 5; ++i) writer.write(Even::of(i));
  });
  ASSERT_TRUE(reader.read(*copy));
  ASSERT_TRUE(copy.fired());
  EXPECT_TRUE((*copy).whole());
  EXPECT_EQ((*copy).word[0], 5u);
}

// The broken twin of Record::read: does not check the sequence again after the copy.
bool read_without_recheck(const Record<Even>& record, std::uint64_t count, Even& value) {
  if (load_word(record.sequence, std::memory_order_acquire) != 2 * count) return false;
  for (std::size_t i = 0; i < 32; ++i) value.word[i] = load_word(record.words[i], std::memory_order_relaxed);
  return true;
}

TEST(Channel, TwinWithoutTheSecondLookAtTheSequenceAcceptsATornValue) {
  auto memory = std::make_unique<Memory>();
  ChannelWriter<Even> writer(*memory);
  writer.write(Even::of(1));
  Halfway<Even> copy;
  copy.arm([&] {
    for (std::uint64_t i = 2; i <= 5; ++i) writer.write(Even::of(i));
  });
  ASSERT_TRUE(read_without_recheck(memory->slots[1].record, 1, *copy));
  EXPECT_FALSE((*copy).whole()) << "the value that this file must detect as torn was not torn";
}

TEST(Channel, HalfAValueUnderAReadersCopyIsNoticed) {
  Shared<Memory> memory;
  ChannelWriter<Even>(*memory).write(Even::of(1));
  Halfway<Even> copy;
  copy.arm([&] { die_in_value_five(*memory); });
  ChannelReader<Even> reader(*memory);
  ASSERT_TRUE(reader.read(*copy));
  ASSERT_TRUE(copy.fired());
  EXPECT_TRUE((*copy).whole());
  EXPECT_EQ((*copy).word[0], 4u) << "the newest value that was finished";
}

// The broken twin of Record::write: does not mark the record before it writes the words.
void write_without_mark(Record<Even>& record, std::uint64_t count, const Even& value) {
  for (std::size_t i = 0; i < 32; ++i) store_word(record.words[i], value.word[i], std::memory_order_relaxed);
  store_word(record.sequence, 2 * count, std::memory_order_release);
}

TEST(Channel, TwinWithoutTheOddMarkGivesReadersHalfAValue) {
  Shared<Memory> memory;
  ChannelWriter<Even>(*memory).write(Even::of(1));
  test::in_child([&memory] {
    Halfway<Even> five(Even::of(5));
    five.arm(test::kill_self);
    write_without_mark(memory->slots[1].record, 5, *five);
  });
  Even value{};
  ASSERT_TRUE(memory->slots[1].record.read(1, value));
  EXPECT_FALSE(value.whole());
}

TEST(Channel, WriterKilledInMidWriteHarmsNobody) {
  Shared<Memory> memory;
  ChannelReader<Even> reader(*memory);
  ChannelWriter<Even>(*memory).write(Even::of(1));
  die_in_value_five(*memory);
  EXPECT_EQ(memory->slots[1].record.sequence, 2 * 5 + 1u) << "the child must have died while the sequence was odd";
  Even value{};
  ASSERT_TRUE(reader.read(value));
  EXPECT_EQ(value.word[0], 4u);
  ChannelWriter<Even>(*memory).write(Even::of(6));
  ASSERT_TRUE(reader.read(value));
  EXPECT_TRUE(value.whole());
  EXPECT_EQ(value.word[0], 6u);
  EXPECT_EQ(reader.failures(), 0u);
}

TEST(Channel, TwinWithASingleSlotIsWedgedByAKilledWriter) {
  Shared<Record<Even>> record;
  record->write(1, Even::of(1), all_words<Even>());
  test::in_child([&record] {
    Halfway<Even> two(Even::of(2));
    two.arm(test::kill_self);
    record->write(2, *two, all_words<Even>());
  });
  Even value{};
  EXPECT_FALSE(record->read(1, value));
  EXPECT_FALSE(record->read(2, value));
}

TEST(Channel, ReaderGivesUpAfterFourTriesAndCountsIt) {
  auto memory = std::make_unique<Memory>();
  memory->latest = 9;  // announced, but never whole
  ChannelReader<Even> reader(*memory);
  memory->slots[1].record.sequence = 2 * 9 + 1;
  Even value{};
  EXPECT_FALSE(reader.read(value));
  EXPECT_EQ(reader.failures(), 1u);
  EXPECT_EQ(reader.seen(), 0u);
}

TEST(Channel, ReaderFindsBackAfterTheMemoryWasWipedUnderIt) {
  auto memory = std::make_unique<Memory>();
  ChannelReader<Even> reader(*memory);
  Even value{};
  for (std::uint64_t i = 1; i <= 1000; ++i) ChannelWriter<Even>(*memory).write(Even::of(i));
  ASSERT_TRUE(reader.read(value));
  for (const int filling : {0x00, 0xff, 0x80}) {
    std::memset(static_cast<void*>(memory.get()), filling, sizeof(Memory));
    ChannelWriter<Even> writer(*memory);
    bool found = false;
    for (std::uint64_t i = 0; i < 300 && !found; ++i) {
      writer.write(Even::of(5000 + i));
      found = reader.read(value) && value.whole() && value.word[0] == 5000 + i;
    }
    EXPECT_TRUE(found) << "filled with " << filling;
  }
}

TEST(Channel, ReadersNeverSeeTornStateNorGoBack) {
  auto memory = std::make_unique<Memory>();
  std::atomic<bool> stop{false};
  std::atomic<std::uint64_t> reads{0};
  const auto watch = [&] {
    ChannelReader<Even> reader(*memory);
    Even value{};
    std::uint64_t last = 0;
    while (!stop.load()) {
      if (!reader.read(value)) continue;
      if (!value.whole() || value.word[0] <= last) {
        ADD_FAILURE() << "after " << last << " came " << value.word[0] << (value.whole() ? "" : ", torn");
        return;
      }
      last = value.word[0];
      reads.fetch_add(1);
    }
  };
  std::thread first(watch);
  std::thread second(watch);
  ChannelWriter<Even> writer(*memory);
  for (std::uint64_t i = 1; i <= 200'000 || reads.load() < 100; ++i) writer.write(Even::of(i));
  stop = true;
  first.join();
  second.join();
}

TEST(Channel, WriterProcessesKilledAtRandomMomentsNeverTearOrStall) {
  Shared<Memory> memory;
  ChannelReader<Even> reader(*memory);
  std::mt19937 random(1);
  Even value{};
  std::uint64_t last = 0;
  for (int round = 0; round < 200; ++round) {
    const pid_t writer = test::start_child([&memory] {
      ChannelWriter<Even> channel(*memory);
      for (std::uint64_t i = load_word(memory->latest, std::memory_order_relaxed) + 1;; ++i) channel.write(Even::of(i));
    });
    const std::uint64_t before = last;
    const auto pause = std::chrono::microseconds(std::uniform_int_distribution(0, 300)(random));
    for (auto end = std::chrono::steady_clock::now() + pause;
         last == before || std::chrono::steady_clock::now() < end;) {
      if (!reader.read(value)) continue;
      ASSERT_TRUE(value.whole()) << "torn in round " << round;
      ASSERT_GE(value.word[0], last) << "an older value in round " << round;
      last = value.word[0];
    }
    kill(writer, SIGKILL);
    waitpid(writer, nullptr, 0);
  }
}

}  // namespace
}  // namespace lithe::ipc
