// SPDX-License-Identifier: Apache-2.0
// Ownership of a bus's descriptor: the Transport thread owns it while the bus is up, the main thread while it is being
// reopened.
#pragma once

#include <atomic>

#include "spine/core/rt.hpp"

namespace lithe::hal {

// One atomic word holds the owner, so that neither thread waits for the other. Only the owner accesses the shared data
// (descriptors, paths).
// Contract: up, lose, regained: RT, Transport thread · lost, give_back: main thread · starts in state up
class Link {
 public:
  // True: the Transport may use the hardware.
  bool up() const LITHE_RT { return up_; }

  // The hardware was lost, with the reason (errno, not 0): from here on the main thread owns it.
  void lose(int error) LITHE_RT {
    up_ = false;
    // release, with the acquire load in lost(): the Transport's last use of the hardware happens before.
    error_.store(error, std::memory_order_release);
  }

  // True once after it was reopened: from here on the Transport owns it again.
  bool regained() LITHE_RT {
    // acquire, with the release store in give_back(): the reopened descriptor is visible completely.
    if (up_ || error_.load(std::memory_order_acquire) != 0) return false;
    up_ = true;
    return true;
  }

  // Why the hardware was lost (errno); 0: it works, or it is reopened and the Transport has not noticed yet.
  int lost() const LITHE_RT {
    // acquire, with the release store in lose().
    return error_.load(std::memory_order_acquire);
  }

  // It has been reopened.
  void give_back() LITHE_RT {
    // release, with the acquire load in regained().
    error_.store(0, std::memory_order_release);
  }

 private:
  bool up_ = true;  // the Transport's own copy
  std::atomic<int> error_{0};
};

}  // namespace lithe::hal
