// SPDX-License-Identifier: Apache-2.0
#include "spine/ipc/mailbox.hpp"

#include <gtest/gtest.h>

#include <atomic>
#include <memory>
#include <random>
#include <thread>

#include "spine/ipc/test/halfway_rig.hpp"

namespace lithe::ipc {
namespace {

using test::Halfway;
using test::Shared;

// All words are equal, unless it is torn.
struct CommandTicket {
  std::uint64_t word[16];

  static CommandTicket of(std::uint64_t number) {
    CommandTicket letter;
    for (std::uint64_t& w : letter.word) w = number;
    return letter;
  }
  bool whole() const {
    for (const std::uint64_t w : word)
      if (w != word[0]) return false;
    return true;
  }
};
constexpr std::size_t kDepth = 4;
struct Box {
  MailboxMemory<CommandTicket, kDepth> letters;
  AckMemory<kDepth> ack;
};
using Sender = MailboxSender<CommandTicket, kDepth>;
using Receiver = MailboxReceiver<CommandTicket, kDepth>;

TEST(Mailbox, EveryLetterArrivesOnceInOrderAndIsAnswered) {
  auto box = std::make_unique<Box>();
  Sender sender(box->letters, box->ack);
  Receiver receiver(box->letters, box->ack);
  CommandTicket letter{};
  std::uint64_t ticket = 0;
  EXPECT_FALSE(receiver.receive(letter, ticket));
  for (std::uint64_t i = 1; i <= 20; ++i) {
    const auto sent = sender.send(CommandTicket::of(i));
    ASSERT_TRUE(sent);
    EXPECT_EQ(sender.poll(*sent), 0u) << "an answer before the letter was read";
    ASSERT_TRUE(receiver.receive(letter, ticket));
    EXPECT_EQ(ticket, *sent);
    EXPECT_EQ(letter.word[0], i);
    EXPECT_EQ(sender.poll(*sent), 0u) << "an answer before one was given";
    receiver.answer(ticket, static_cast<std::uint32_t>(100 + i));
    EXPECT_EQ(sender.poll(*sent), 100 + i);
    EXPECT_FALSE(receiver.receive(letter, ticket));
  }
  EXPECT_EQ(receiver.violations(), 0u);
}

TEST(Mailbox, FullMailboxRefusesInsteadOfOverwriting) {
  auto box = std::make_unique<Box>();
  Sender sender(box->letters, box->ack);
  Receiver receiver(box->letters, box->ack);
  for (std::uint64_t i = 1; i <= kDepth; ++i) ASSERT_TRUE(sender.send(CommandTicket::of(i)));
  EXPECT_FALSE(sender.send(CommandTicket::of(99)));
  CommandTicket letter{};
  std::uint64_t ticket = 0;
  for (std::uint64_t i = 1; i <= kDepth; ++i) {
    ASSERT_TRUE(receiver.receive(letter, ticket));
    EXPECT_EQ(letter.word[0], i);
  }
  EXPECT_TRUE(sender.send(CommandTicket::of(5)));
}

TEST(Mailbox, NewReceiverPassesOverLettersOfAnEarlierRun) {
  auto box = std::make_unique<Box>();
  Sender sender(box->letters, box->ack);
  Receiver first(box->letters, box->ack);
  ASSERT_TRUE(sender.send(CommandTicket::of(1)));
  box->ack = {};  // the receiver's segment was created again
  Receiver second(box->letters, box->ack);
  CommandTicket letter{};
  std::uint64_t ticket = 0;
  EXPECT_FALSE(second.receive(letter, ticket));
  ASSERT_TRUE(sender.send(CommandTicket::of(2)));
  ASSERT_TRUE(second.receive(letter, ticket));
  EXPECT_EQ(letter.word[0], 2u);
}

TEST(Mailbox, LetterIsNotAnnouncedBeforeItIsWhole) {
  auto box = std::make_unique<Box>();
  Sender sender(box->letters, box->ack);
  Receiver receiver(box->letters, box->ack);
  CommandTicket letter{};
  std::uint64_t ticket = 0;
  Halfway<CommandTicket> half(CommandTicket::of(1));
  half.arm([&] { EXPECT_FALSE(receiver.receive(letter, ticket)); });
  ASSERT_TRUE(sender.send(*half));
  ASSERT_TRUE(half.fired());
  ASSERT_TRUE(receiver.receive(letter, ticket));
  EXPECT_TRUE(letter.whole());
  EXPECT_EQ(receiver.violations(), 0u);
}

// The broken twin of MailboxSender::send: increments the head before it writes the letter.
TEST(Mailbox, TwinThatAnnouncesFirstLosesTheLetter) {
  auto box = std::make_unique<Box>();
  Receiver receiver(box->letters, box->ack);
  CommandTicket letter{};
  std::uint64_t ticket = 0;
  Halfway<CommandTicket> half(CommandTicket::of(1));
  half.arm([&] { EXPECT_FALSE(receiver.receive(letter, ticket)); });
  store_word(box->letters.head, 1, std::memory_order_release);
  box->letters.slots[0].record.write(1, *half, all_words<CommandTicket>());
  EXPECT_EQ(receiver.violations(), 1u);
  EXPECT_FALSE(receiver.receive(letter, ticket)) << "the letter was lost";
}

TEST(Mailbox, SenderCannotOverwriteALetterThatIsBeingCopied) {
  auto box = std::make_unique<Box>();
  Sender sender(box->letters, box->ack);
  Receiver receiver(box->letters, box->ack);
  ASSERT_TRUE(sender.send(CommandTicket::of(1)));
  Halfway<CommandTicket> copy;
  int accepted = 0;
  copy.arm([&] {
    for (std::uint64_t i = 2; i <= 9; ++i) accepted += sender.send(CommandTicket::of(i)) ? 1 : 0;
  });
  std::uint64_t ticket = 0;
  ASSERT_TRUE(receiver.receive(*copy, ticket));
  ASSERT_TRUE(copy.fired());
  EXPECT_TRUE((*copy).whole());
  EXPECT_EQ(accepted, 3) << "the fourth would overwrite the letter that is being copied";
}

// The broken twin of MailboxReceiver::receive: frees the slot before it has copied the letter.
TEST(Mailbox, TwinThatGivesTheSlotBackFirstLosesTheLetter) {
  auto box = std::make_unique<Box>();
  Sender sender(box->letters, box->ack);
  ASSERT_TRUE(sender.send(CommandTicket::of(1)));
  Halfway<CommandTicket> copy;
  copy.arm([&] {
    for (std::uint64_t i = 2; i <= 9; ++i) sender.send(CommandTicket::of(i));
  });
  store_word(box->ack.tail, 1, std::memory_order_release);
  EXPECT_FALSE(box->letters.slots[0].record.read(1, *copy));
}

TEST(Mailbox, SenderKilledInMidLetterLeavesNothingBehind) {
  Shared<Box> box;
  Receiver receiver(box->letters, box->ack);
  test::in_child([&box] {
    Halfway<CommandTicket> half(CommandTicket::of(1));
    half.arm(test::kill_self);
    Sender(box->letters, box->ack).send(*half);
  });
  CommandTicket letter{};
  std::uint64_t ticket = 0;
  EXPECT_FALSE(receiver.receive(letter, ticket));
  ASSERT_TRUE(Sender(box->letters, box->ack).send(CommandTicket::of(2)));
  ASSERT_TRUE(receiver.receive(letter, ticket));
  EXPECT_TRUE(letter.whole());
  EXPECT_EQ(letter.word[0], 2u);
  EXPECT_EQ(receiver.violations(), 0u);
}

TEST(Mailbox, ImpossibleHeadIsCountedAndSkipped) {
  auto box = std::make_unique<Box>();
  Sender sender(box->letters, box->ack);
  Receiver receiver(box->letters, box->ack);
  CommandTicket letter{};
  std::uint64_t ticket = 0;
  for (const std::uint64_t head : {std::uint64_t{5}, std::uint64_t{0}, std::uint64_t{1} << 63, ~std::uint64_t{0}}) {
    const std::uint64_t before = receiver.violations();
    box->letters.head = head;
    for (int i = 0; i < 10; ++i) EXPECT_FALSE(receiver.receive(letter, ticket));
    EXPECT_GT(receiver.violations(), before) << "head " << head;
    ASSERT_TRUE(sender.send(CommandTicket::of(7))) << "letters of a correct sender must arrive again";
    ASSERT_TRUE(receiver.receive(letter, ticket));
    EXPECT_EQ(letter.word[0], 7u);
  }
}

TEST(Mailbox, AnswersOfOtherTicketsAreNotTaken) {
  auto box = std::make_unique<Box>();
  Sender sender(box->letters, box->ack);
  Receiver receiver(box->letters, box->ack);
  receiver.answer(1, 9);
  EXPECT_EQ(sender.poll(1), 9u);
  EXPECT_EQ(sender.poll(1 + kDepth), 0u) << "the same slot, another ticket";
}

TEST(Mailbox, NothingIsLostBetweenThreads) {
  auto box = std::make_unique<Box>();
  Receiver receiver(box->letters, box->ack);
  constexpr std::uint64_t kLetters = 50'000;
  std::thread sending([&] {
    Sender sender(box->letters, box->ack);
    for (std::uint64_t i = 1; i <= kLetters;)
      if (sender.send(CommandTicket::of(i)))
        ++i;
      else
        std::this_thread::yield();
  });
  CommandTicket letter{};
  std::uint64_t ticket = 0;
  std::uint64_t next = 1;
  while (next <= kLetters) {
    if (!receiver.receive(letter, ticket)) {
      std::this_thread::yield();
      continue;
    }
    if (!letter.whole() || letter.word[0] != next || ticket != next) {
      ADD_FAILURE() << "expected letter " << next << ", got " << letter.word[0];
      break;
    }
    receiver.answer(ticket, 1);
    ++next;
  }
  sending.join();
  EXPECT_EQ(receiver.violations(), 0u);
}

TEST(Mailbox, SenderProcessesKilledAtRandomMomentsLoseNoAnnouncedLetter) {
  Shared<Box> box;
  Receiver receiver(box->letters, box->ack);
  std::mt19937 random(3);
  CommandTicket letter{};
  std::uint64_t ticket = 0;
  std::uint64_t last = 0;
  for (int round = 0; round < 100; ++round) {
    const pid_t child = test::start_child([&box] {
      Sender sender(box->letters, box->ack);
      for (;;) {
        const std::uint64_t next = load_word(box->letters.head, std::memory_order_relaxed) + 1;
        if (!sender.send(CommandTicket::of(next))) std::this_thread::yield();
      }
    });
    const std::uint64_t enough = last + std::uniform_int_distribution<std::uint64_t>(1, 300)(random);
    while (last < enough) {
      if (!receiver.receive(letter, ticket)) {
        std::this_thread::yield();
        continue;
      }
      ASSERT_TRUE(letter.whole()) << "round " << round;
      ASSERT_EQ(letter.word[0], last + 1) << "round " << round;
      last = letter.word[0];
    }
    kill(child, SIGKILL);
    waitpid(child, nullptr, 0);
  }
  EXPECT_EQ(receiver.violations(), 0u);
}

}  // namespace
}  // namespace lithe::ipc
