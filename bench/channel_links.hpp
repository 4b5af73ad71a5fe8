// SPDX-License-Identifier: Apache-2.0
// Ways to send a message from one thread to another, behind one small interface.
#pragma once

#include <cstdint>
#include <memory>

namespace lithe::bench {

// A two-way connection between two threads. The message has `bytes` bytes and a sequence number; a side sends one
// and polls for the answer. So every kind is measured spinning, where it is fastest.
// Contract: one thread per side · side 0 asks, side 1 answers
class Link {
 public:
  virtual ~Link() = default;
  virtual const char* name() const = 0;
  virtual void send(int side, std::uint64_t sequence) = 0;
  // True when message `sequence` has arrived whole. Never blocks.
  virtual bool arrived(int side, std::uint64_t sequence) = 0;
};

std::unique_ptr<Link> make_cache_line_link();     // a raw cache line, 56 bytes and a number: the hardware's limit
std::unique_ptr<Link> make_one_word_link();       // a raw atomic word
std::unique_ptr<Link> make_raw_plan_link();       // raw words, as many as a plan has
std::unique_ptr<Link> make_channel_56_link();     // lithe Channel, the same 56 bytes
std::unique_ptr<Link> make_channel_256_link();    // lithe Channel, 256 bytes
std::unique_ptr<Link> make_channel_plan_link();   // lithe Channel, a plan
std::unique_ptr<Link> make_unix_datagram_link();  // socketpair, 256 bytes
std::unique_ptr<Link> make_zeromq_link();         // PAIR over ipc://, 256 bytes

}  // namespace lithe::bench
