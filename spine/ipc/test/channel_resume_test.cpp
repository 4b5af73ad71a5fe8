// SPDX-License-Identifier: Apache-2.0
// A reader may see a value before it is announced; a writer that dies in between must not confuse a reader.
#include <gtest/gtest.h>

#include <memory>

#include "spine/ipc/channel.hpp"
#include "spine/ipc/test/halfway_rig.hpp"

namespace lithe::ipc {
namespace {

struct Pair {
  std::uint64_t a;
  std::uint64_t b;
};
using Memory = ChannelMemory<Pair>;

TEST(ChannelResume, ReaderThatKeepsUpNeedsNoAnnouncement) {
  auto memory = std::make_unique<Memory>();
  ChannelReader<Pair> reader(*memory);
  ChannelWriter<Pair>(*memory).write({1, 1});
  memory->latest = 0;  // died before announcing
  Pair value{};
  ASSERT_TRUE(reader.read(value));
  EXPECT_EQ(value.a, 1u);
  EXPECT_FALSE(reader.read(value));
}

TEST(ChannelResume, NewWriterPassesOverANumberThatAReaderMayHave) {
  auto memory = std::make_unique<Memory>();
  ChannelReader<Pair> reader(*memory);
  ChannelWriter<Pair>(*memory).write({1, 1});
  memory->latest = 0;
  Pair value{};
  ASSERT_TRUE(reader.read(value));
  ChannelWriter<Pair>(*memory).write({2, 2});
  ASSERT_TRUE(reader.read(value)) << "the first value of the new writer was taken for the last of the old one";
  EXPECT_EQ(value.a, 2u);
}

TEST(ChannelResume, NewWriterAnnouncesItsPredecessorsValueBeforeItWritesItsOwn) {
  auto memory = std::make_unique<Memory>();
  ChannelReader<Pair> reader(*memory);
  ChannelWriter<Pair>(*memory).write({1, 1});
  ChannelWriter<Pair>(*memory).write({2, 2});
  memory->latest = 1;
  Pair value{};
  ASSERT_TRUE(reader.read(value));
  ASSERT_TRUE(reader.read(value));
  EXPECT_EQ(value.a, 2u);
  test::Halfway<Pair> third(Pair{3, 3});
  std::uint64_t announced = 0;
  third.arm([&] { announced = memory->latest; });
  ChannelWriter<Pair>(*memory).write(*third);
  ASSERT_TRUE(third.fired());
  EXPECT_EQ(announced, 2u) << "a reader of value 3 would be two ahead of `latest` and taken back to value 1";
  ASSERT_TRUE(reader.read(value));
  EXPECT_EQ(value.a, 3u);
  memory->latest = 2;  // and this one dies before announcing
  for (int i = 0; i < 1000; ++i) ASSERT_FALSE(reader.read(value)) << "back to the older value " << value.a;
}

TEST(ChannelResume, ReaderThatFellBehindGetsTheNewest) {
  for (std::uint64_t behind = 1; behind <= 9; ++behind) {
    auto memory = std::make_unique<Memory>();
    ChannelReader<Pair> reader(*memory);
    ChannelWriter<Pair> writer(*memory);
    Pair value{};
    writer.write({100, 100});
    ASSERT_TRUE(reader.read(value));
    for (std::uint64_t i = 1; i <= behind; ++i) writer.write({i, i});
    ASSERT_TRUE(reader.read(value)) << behind << " behind";
    EXPECT_EQ(value.a, behind);
    EXPECT_FALSE(reader.read(value));
  }
}

TEST(ChannelResume, LateAnnouncementNeverTakesAReaderBack) {
  auto memory = std::make_unique<Memory>();
  ChannelReader<Pair> reader(*memory);
  ChannelWriter<Pair> writer(*memory);
  Pair value{};
  for (std::uint64_t i = 1; i <= 3; ++i) writer.write({i, i});
  ASSERT_TRUE(reader.read(value));
  memory->latest = 1;                            // as if it were still being written
  memory->slots[0].record.sequence = 2 * 8 | 1;  // and the record of the next value is already a much later one
  EXPECT_FALSE(reader.read(value));
}

}  // namespace
}  // namespace lithe::ipc
