// SPDX-License-Identifier: Apache-2.0
// The only code through which Python touches shared words. Same protocols as spine/ipc: payloads move as relaxed 64-bit
// atomics between the fences named at each place, so a reader never accepts a torn copy, also on ARM.
#include <stdatomic.h>
#include <stddef.h>
#include <stdint.h>

// tools/gen.py writes these three from schema/wire.toml.
#define LITHE_LINE 128
#define LITHE_RECORD_ALIGN 64
#define LITHE_LAYOUT_HASH UINT64_C(0x9c46026e67ebf03e)

typedef _Atomic uint64_t Word;

static size_t round_up(size_t value, size_t to) { return (value + to - 1) / to * to; }

static void copy_out(uint64_t* to, Word* from, size_t words) {
  for (size_t i = 0; i < words; ++i) to[i] = atomic_load_explicit(&from[i], memory_order_relaxed);
}

static void copy_in(Word* to, const uint64_t* from, size_t words) {
  for (size_t i = 0; i < words; ++i) atomic_store_explicit(&to[i], from[i], memory_order_relaxed);
}

uint64_t lithe_layout_hash(void) { return LITHE_LAYOUT_HASH; }

uint64_t lithe_load(void* word) { return atomic_load_explicit((Word*)word, memory_order_acquire); }

void lithe_store(void* word, uint64_t value) { atomic_store_explicit((Word*)word, value, memory_order_release); }

// Copies `bytes` (a multiple of 8) word by word: each word whole, the block not. For histograms.
void lithe_copy(void* to, void* from, size_t bytes) { copy_out(to, from, bytes / 8); }

// A record guarded by its sequence word: 2c while it holds value c, odd while it is being written.
static int read_record(Word* slot, uint64_t expected, void* to, size_t bytes) {
  // acquire, with the release store of the same sequence: the payload of value c is visible.
  if (atomic_load_explicit(slot, memory_order_acquire) != expected) return 0;
  copy_out(to, slot + 1, bytes / 8);
  // acquire fence, with the writer's release fence after its odd store: had a word come from a later value, the check
  // below would see that value's odd sequence.
  atomic_thread_fence(memory_order_acquire);
  return atomic_load_explicit(slot, memory_order_relaxed) == expected;
}

static void write_record(Word* slot, uint64_t count, const void* from, size_t bytes) {
  atomic_store_explicit(slot, 2 * count | 1, memory_order_relaxed);
  // release fence: the odd sequence is visible before any word of the new value.
  atomic_thread_fence(memory_order_release);
  copy_in(slot + 1, from, bytes / 8);
  // release: every word is visible before the even sequence says so.
  atomic_store_explicit(slot, 2 * count, memory_order_release);
}

// ---- channel: u64 latest, then four slots
// Returns the count of the value copied to `to`, 0 when there is none yet, UINT64_MAX after four failed tries.
uint64_t lithe_channel_read(void* channel, void* to, size_t bytes) {
  Word* latest = channel;
  const size_t stride = round_up(8 + bytes, LITHE_LINE);
  for (int attempt = 0; attempt < 4; ++attempt) {
    const uint64_t count = atomic_load_explicit(latest, memory_order_acquire);
    if (count == 0) return 0;
    if (read_record((Word*)((char*)channel + LITHE_LINE + (count & 3) * stride), 2 * count, to, bytes)) return count;
  }
  return UINT64_MAX;
}

void lithe_channel_write(void* channel, const void* from, size_t bytes) {
  Word* latest = channel;
  const size_t stride = round_up(8 + bytes, LITHE_LINE);
  uint64_t count = atomic_load_explicit(latest, memory_order_relaxed) + 1;
  // A predecessor died between its value and the announcement: announce it, because a reader may have it already.
  Word* next = (Word*)((char*)channel + LITHE_LINE + (count & 3) * stride);
  // acquire: the predecessor's value comes before our announcement of it.
  if (atomic_load_explicit(next, memory_order_acquire) == 2 * count)
    atomic_store_explicit(latest, count++, memory_order_release);
  write_record((Word*)((char*)channel + LITHE_LINE + (count & 3) * stride), count, from, bytes);
  atomic_store_explicit(latest, count, memory_order_release);
}

// ---- ring: u64 head (records ever written), then `depth` records; record n (from 1) lies at (n - 1) % depth
uint64_t lithe_ring_head(void* ring) { return atomic_load_explicit((Word*)ring, memory_order_acquire); }

// Copies up to `most` records after *cursor (records already seen) to `to`, oldest first; moves *cursor on and adds
// what was overwritten before it could be read to *lost. Returns how many were copied.
size_t lithe_ring_drain(void* ring, size_t depth, size_t bytes, uint64_t* cursor, void* to, size_t most,
                        uint64_t* lost) {
  const size_t stride = round_up(8 + bytes, LITHE_RECORD_ALIGN);
  const uint64_t head = lithe_ring_head(ring);
  uint64_t next = *cursor;
  if (next > head) next = head;  // the ring was made anew
  if (head - next > depth) {
    *lost += head - depth - next;
    next = head - depth;
  }
  size_t copied = 0;
  while (next < head && copied < most) {
    const uint64_t count = next + 1;
    Word* slot = (Word*)((char*)ring + LITHE_LINE + (next % depth) * stride);
    if (read_record(slot, 2 * count, (char*)to + copied * bytes, bytes))
      ++copied;
    else
      ++*lost;  // the writer has come round
    ++next;
  }
  *cursor = next;
  return copied;
}

// The newest record. Returns its number, 0 when there is none, UINT64_MAX after four failed tries.
uint64_t lithe_ring_latest(void* ring, size_t depth, size_t bytes, void* to) {
  const size_t stride = round_up(8 + bytes, LITHE_RECORD_ALIGN);
  for (int attempt = 0; attempt < 4; ++attempt) {
    const uint64_t head = lithe_ring_head(ring);
    if (head == 0) return 0;
    if (read_record((Word*)((char*)ring + LITHE_LINE + ((head - 1) % depth) * stride), 2 * head, to, bytes))
      return head;
  }
  return UINT64_MAX;
}

// ---- mailbox: u64 head, then `depth` letters; its ack: u64 tail, then `depth` results (ticket << 32 | code)
// Returns the ticket, or 0 when `depth` letters are still unread.
uint64_t lithe_mailbox_send(void* mailbox, void* ack, size_t depth, const void* from, size_t bytes) {
  Word* head = mailbox;
  const size_t stride = round_up(8 + bytes, LITHE_RECORD_ALIGN);
  const uint64_t sent = atomic_load_explicit(head, memory_order_relaxed);
  // acquire, with the receiver's release store: it has copied the letter we are about to overwrite.
  const uint64_t read = atomic_load_explicit((Word*)ack, memory_order_acquire);
  if (sent - read >= depth) return 0;
  write_record((Word*)((char*)mailbox + LITHE_LINE + (sent % depth) * stride), sent + 1, from, bytes);
  atomic_store_explicit(head, sent + 1, memory_order_release);
  return sent + 1;
}

// The receiver's answer to `ticket`: its code, or 0 while pending.
uint32_t lithe_mailbox_poll(void* ack, size_t depth, uint64_t ticket) {
  const uint64_t result =
      atomic_load_explicit((Word*)((char*)ack + LITHE_LINE) + (ticket - 1) % depth, memory_order_acquire);
  return (uint32_t)(result >> 32) == (uint32_t)ticket ? (uint32_t)result : 0;
}
