/* SPDX-License-Identifier: Apache-2.0
 * The Ring, a broadcast of the last N records. Code: spine/ipc/ring.hpp, its records: spine/ipc/words.hpp.
 *
 * First the writer: RingWriter::push. It may die after any store; then another one continues with the contents of the
 * memory, and writes a record that was not announced again. Then the reader, in any order: RingReader::next,
 * latest, rewind, empty. It stores nothing that others load, so one reader stands for many, and the writer may run first.
 *
 * Constants: 2 records of 2 words.
 *
 * claim torn       a record that is given is one whole record, and the announced one of its number
 * claim missed     a record fails to be read only when the writer has begun the one that overwrites it
 * claim backwards  the cursor is never ahead of `head`
 * claim denied     when empty() has said no, next() does not say that there is none
 *
 * Stronger than needed: a record is read only after its number was acquired from `head`, so the even sequence (release, acquire) adds
 * nothing here; the Channel needs it. The constructor, rewind() and empty() give no record: next() acquires `head` again.
 */
//: code spine/ipc/ring.hpp RingWriter::push push
//: code spine/ipc/ring.hpp RingReader::RingReader start
//: code spine/ipc/ring.hpp RingReader::rewind rewind
//: code spine/ipc/ring.hpp RingReader::next next_record
//: code spine/ipc/ring.hpp RingReader::latest latest
//: code spine/ipc/ring.hpp RingReader::empty is_empty
//: model
//: model -DSPARE_READ -DTWIN_EVEN_RELAXED -DSPARE_START -DSPARE_REWIND -DSPARE_EMPTY
//: twin HEAD_RELAXED      missed  `head` is stored without release
//: twin NEXT_RELAXED      missed  next() loads `head` without acquire
//: twin LATEST_RELAXED    missed  latest() loads `head` without acquire
//: twin NO_RELEASE_FENCE  torn    no fence between the odd mark and the words
//: twin NO_ACQUIRE_FENCE  torn    no fence between the copy and the second look at the sequence
//: twin HEAD_BEFORE_FILL  missed  a record is announced before it is written

#define RECORDS 2
#define WRITES 4 /* begun by all writers together */
#define KILLS 1

/* RingMemory */
#define HEAD 0
#define SEQUENCE(slot) (1 + (slot))
#define WORD(slot, word) (1 + RECORDS + WORDS * (slot) + (word))
#define WORDS 2
#define OBJECTS (1 + RECORDS + WORDS * RECORDS)
#define MESSAGES (2 * WRITES + 1)
#define USES 1
#include "memory.inc"

#define writer 0
#define reader 1
#define SLOT(count) ((count - 1) % RECORDS)
#define MAY_DIE \
  if \
  :: true \
  :: kills < KILLS -> kills++; goto dead \
  fi
#include "record.inc"

byte kills, count, head;
/* Only in the model, not in the code. Every push() has its own stamp, which stands for its record. */
byte stamp;
byte announced[WRITES + 1]; /* stamp of each number */

bool torn, missed, backwards, denied;

inline push() {
  load_own(writer, HEAD, relaxed, count);
  count++;
#ifdef TWIN_HEAD_BEFORE_FILL
  announced[count] = stamp;
  store(writer, HEAD, count, ORDER(release, TWIN_HEAD_RELAXED));
#endif
  record_write(writer, SLOT(count), count, stamp);
#ifndef TWIN_HEAD_BEFORE_FILL
  announced[count] = stamp;
  store(writer, HEAD, count, ORDER(release, TWIN_HEAD_RELAXED));
  MAY_DIE
#endif
}

inline start() {
  load(reader, HEAD, ORDER(acquire, SPARE_START), next)
}

inline rewind() {
  load(reader, HEAD, ORDER(acquire, SPARE_REWIND), head);
  next = (head > RECORDS -> head - RECORDS : 0)
}

/* A record was copied, or not. */
inline judge(number) {
  d_step {
    CLAIM(missed, whole || there >= WHOLE(number + RECORDS));
    CLAIM(torn, !whole || (got[0] == got[1] && got[0] == announced[number]));
    got[0] = 0;
    got[1] = 0;
    there = 0;
    whole = false
  }
}

inline next_record() {
  load(reader, HEAD, ORDER(acquire, TWIN_NEXT_RELAXED), head);
  CLAIM(backwards, next <= head);
  CLAIM(denied, !promised || head != next);
  promised = false;
  if
  :: head != next ->
    next = (head - next > RECORDS -> head - RECORDS : next) + 1;
    record_read(reader, SLOT(next), next);
    judge(next)
  :: else
  fi
}

/* One of the four tries. */
inline latest() {
  load(reader, HEAD, ORDER(acquire, TWIN_LATEST_RELAXED), head);
  if
  :: head != 0 ->
    record_read(reader, SLOT(head), head);
    judge(head)
  :: else
  fi
}

inline is_empty() {
  load(reader, HEAD, ORDER(acquire, SPARE_EMPTY), head);
  promised = (head != next)
}

init {
  byte next;     /* next_ */
  bool promised; /* ghost: empty() has just said no */

  atomic {
alive:
    do
    :: stamp < WRITES ->
      stamp++;
      push()
    :: else -> break
    od;
    goto gone;
dead:
    word = 0;
    thread[writer].fenced = 0; /* the fence of one thread is none of the next */
    if
    :: goto alive
    :: goto gone
    fi;
gone:
    count = 0
  }

  start();
  do
  :: next_record(); head = 0; forget_known(reader)
  :: latest(); head = 0; forget_known(reader)
  :: rewind(); head = 0; promised = false; forget_known(reader)
  :: is_empty(); head = 0; forget_known(reader)
  od
}
