// SPDX-License-Identifier: Apache-2.0
// Whose the hardware of a bus is: the exchange's while it works, the housekeeping's while it is brought back.
#pragma once

#include <atomic>

#include "spine/core/rt.hpp"

namespace lithe::hal {

// One word that says it, so that neither ever waits for the other. What the two share (descriptors, paths) is touched
// only by the side whose it is.
// Contract: up, lose, regained RT, the exchange's thread · lost, give_back the housekeeping's · starts up
class Link {
 public:
  // True: the exchange may use the hardware.
  bool up() const LITHE_RT { return up_; }

  // The hardware is gone, and why (errno, not 0): from here on it is the housekeeping's.
  void lose(int error) LITHE_RT {
    up_ = false;
    // release, with the acquire load in lost(): the exchange has touched the hardware for the last time.
    error_.store(error, std::memory_order_release);
  }

  // True once after it came back: from here on it is the exchange's again.
  bool regained() LITHE_RT {
    // acquire, with the release store in give_back(): what was opened is seen whole.
    if (up_ || error_.load(std::memory_order_acquire) != 0) return false;
    up_ = true;
    return true;
  }

  // Why the hardware is gone (errno); 0: it works, or it waits for the exchange to notice that it does.
  int lost() const LITHE_RT {
    // acquire, with the release store in lose().
    return error_.load(std::memory_order_acquire);
  }

  // It works again.
  void give_back() LITHE_RT {
    // release, with the acquire load in regained().
    error_.store(0, std::memory_order_release);
  }

 private:
  bool up_ = true;  // the exchange's own view
  std::atomic<int> error_{0};
};

}  // namespace lithe::hal
