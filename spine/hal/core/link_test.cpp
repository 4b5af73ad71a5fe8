// SPDX-License-Identifier: Apache-2.0
#include "spine/hal/core/link.hpp"

#include <gtest/gtest.h>

#include <atomic>
#include <cerrno>
#include <thread>

namespace lithe::hal {
namespace {

// The broken twin of Link: the exchange does not wait to be given the hardware, it looks whether there is an error.
class HastyLink {
 public:
  bool up() const { return error_.load(std::memory_order_acquire) == 0; }
  void lose(int error) { error_.store(error, std::memory_order_release); }
  bool regained() { return false; }
  int lost() const { return error_.load(std::memory_order_acquire); }
  void give_back() { error_.store(0, std::memory_order_release); }

 private:
  std::atomic<int> error_{0};
};

// What is on the hardware's other side must hear of the exchange that it begins before it hears anything else in it.
// Says whether one was used without having been greeted, when it comes back in the middle of an exchange.
template <class AnyLink>
bool uses_hardware_it_has_not_taken_over() {
  AnyLink link;
  link.lose(EIO);
  bool greeted = false;
  if (link.regained()) greeted = true;  // the exchange begins: still gone
  link.give_back();                     // the housekeeping, meanwhile
  return link.up() && !greeted;         // the exchange sends
}

TEST(Link, HardwareThatComesBackInAnExchangeIsUsedFromTheNextOneOn) {
  EXPECT_FALSE(uses_hardware_it_has_not_taken_over<Link>());
  EXPECT_TRUE(uses_hardware_it_has_not_taken_over<HastyLink>()) << "the test must be able to fail";
}

TEST(Link, TellsOnceThatTheHardwareIsBack) {
  Link link;
  EXPECT_TRUE(link.up());
  EXPECT_FALSE(link.regained());
  link.lose(ENODEV);
  EXPECT_FALSE(link.up());
  EXPECT_EQ(link.lost(), ENODEV);
  EXPECT_FALSE(link.regained());
  link.give_back();
  EXPECT_EQ(link.lost(), 0);
  EXPECT_TRUE(link.regained());
  EXPECT_TRUE(link.up());
  EXPECT_FALSE(link.regained());
}

// ThreadSanitizer sees the rest: the plain word is the hardware.
TEST(Link, OnlyOneSideTouchesTheHardwareAtATime) {
  Link link;
  std::uint64_t hardware = 0;
  std::atomic<bool> over{false};
  std::thread housekeeping([&] {
    while (!over.load(std::memory_order_relaxed)) {
      if (link.lost() == 0) {
        std::this_thread::yield();
        continue;
      }
      ++hardware;
      link.give_back();
    }
  });
  std::uint64_t exchanges = 0;
  for (std::uint64_t lost = 0; lost < 2'000;) {
    if (!link.regained() && !link.up()) {
      std::this_thread::yield();
      continue;
    }
    ++hardware;
    if (++exchanges % 3 == 0) {
      link.lose(EIO);
      ++lost;
    }
  }
  over.store(true, std::memory_order_relaxed);
  housekeeping.join();
  EXPECT_GE(hardware, exchanges + 1'999);
}

}  // namespace
}  // namespace lithe::hal
