/* SPDX-License-Identifier: Apache-2.0
 * The four-slot Channel. Code: spine/ipc/channel.hpp, its records: spine/ipc/words.hpp.
 *
 * First the writer: ChannelWriter::write. It may die after any store; then another one continues with the contents of
 * the memory (the lease of the segment orders the two: what the first has done happens before what the second does).
 * Then the reader: ChannelReader::read. It stores nothing that others load, so one reader stands for many, and
 * the writer may run first: what a load finds in the meantime are the older messages.
 *
 * Constants: a value has 2 words, not up to 500; a reader asks `latest` after IDLE reads. It may give up after any try.
 *
 * claim torn       a read that succeeds gives words of one value only
 * claim backwards  each value read is younger than the one before
 * claim stale      a reader that has seen `latest` does not say that there is nothing newer than an older value
 * claim disturbed  a copy fails only when the writer has begun the value four later
 * claim blocked    a read ends within TRIES tries, whatever the writer does or has left in memory
 * claim lost       once everything is visible, a reader has the newest whole value after two reads
 *
 * Stronger than needed: the acquire loads in newest() (sequence_of) and at the start of Record::read are of the same sequence, and
 * either is enough; in write(), the lease already does what the acquire load does.
 */
//: code spine/ipc/channel.hpp ChannelWriter::write write
//: code spine/ipc/channel.hpp ChannelReader::newest newest
//: code spine/ipc/channel.hpp ChannelReader::resume resume
//: code spine/ipc/channel.hpp ChannelReader::sequence_of sequence_of
//: model -DWRITES=6 -DKILLS=1
//: model -DWRITES=5 -DKILLS=2
//: model -DWRITES=5 -DKILLS=1 -DSPARE_READ
//: model -DWRITES=5 -DKILLS=1 -DSPARE_SEQUENCE_OF
//: twin NO_RELEASE_FENCE       torn       no fence between the odd mark and the words
//: twin EVEN_RELAXED           backwards  the even sequence is stored without release
//: twin NO_ACQUIRE             backwards  neither newest() nor Record::read acquires the sequence
//: twin NO_ACQUIRE_FENCE       torn       no fence between the copy and the second look at the sequence
//: twin LATEST_RELAXED         stale      `latest` is stored without release
//: twin REPAIR_RELAXED         stale      a successor announces a finished value without release
//: twin ASK_RELAXED            disturbed  newest() loads `latest` without acquire
//: twin RESUME_RELAXED         stale      resume() loads `latest` without acquire
//: twin ONE_LOOK               torn       read() does not look at the sequence again after the copy
//: twin NO_MARK                torn       write() does not mark the record odd
//: twin ANNOUNCE_BEFORE_FILL   stale      `latest` is stored before the record is written
//: twin THREE_SLOTS            disturbed  three slots instead of four
//: twin SAME_NUMBER            lost       a successor writes a finished number again
//: twin SKIP_UNANNOUNCED       backwards  a successor skips a finished number and does not announce it
//: twin ASK_LATEST             backwards  a reader trusts `latest` more than the records
//: twin WAIT_WHILE_ODD         blocked    a reader waits for a record to be finished, as with a plain seqlock

#ifdef TWIN_THREE_SLOTS
#define SLOTS 3
#else
#define SLOTS 4
#endif
#ifndef WRITES
#define WRITES 5 /* begun by all writers together */
#endif
#ifndef KILLS
#define KILLS 2
#endif
#define TRIES 4
#define IDLE 2
#ifdef TWIN_NO_ACQUIRE
#define SPARE_READ 1
#define SPARE_SEQUENCE_OF 1
#endif

/* ChannelMemory */
#define LATEST 0
#define SEQUENCE(slot) (1 + (slot))
#define WORD(slot, word) (1 + SLOTS + WORDS * (slot) + (word))
#define WORDS 2
#define OBJECTS (1 + SLOTS + WORDS * SLOTS)
#define MESSAGES (WRITES + 1)
#define USES 1
#include "memory.inc"

#define writer 0
#define reader 1
#define SLOT(count) ((count) % SLOTS)
#define MAY_DIE \
  if \
  :: true \
  :: kills < KILLS -> kills++; goto dead \
  fi
#include "record.inc"

byte kills, count;
/* Only in the model, not in the code. Every write() has its own stamp, which stands for its value. */
byte stamp;          /* of the write begun last */
byte finished;       /* number of the newest value whose even sequence is stored */
byte finished_stamp; /* and which value that is */

bool torn, backwards, stale, disturbed, blocked, lost;

inline write() {
  load_own(writer, LATEST, relaxed, count);
  count++;
  load_own(writer, SEQUENCE(SLOT(count)), acquire, there);
#ifndef TWIN_SAME_NUMBER
  if
  :: there == WHOLE(count) ->
#ifndef TWIN_SKIP_UNANNOUNCED
    store(writer, LATEST, count, ORDER(release, TWIN_REPAIR_RELAXED));
    MAY_DIE;
#endif
    count++
  :: else
  fi;
#endif
#ifdef TWIN_ANNOUNCE_BEFORE_FILL
  store(writer, LATEST, count, ORDER(release, TWIN_LATEST_RELAXED));
#endif
  record_write(writer, SLOT(count), count, stamp);
#ifndef TWIN_ANNOUNCE_BEFORE_FILL
  store(writer, LATEST, count, ORDER(release, TWIN_LATEST_RELAXED));
  MAY_DIE
#endif
}

inline sequence_of(number) {
  load(reader, SEQUENCE(SLOT(number)), ORDER(acquire, SPARE_SEQUENCE_OF), there)
}

/* Sets `count`. */
inline newest() {
#ifdef TWIN_WAIT_WHILE_ODD
  do
  :: sequence_of(seen + 1);
    if
    :: there == WRITING(seen + 1) -> tries++; CLAIM(blocked, tries <= TRIES)
    :: else -> break
    fi
  od;
#endif
  sequence_of(seen + 1);
  count = seen;
  ask = (there > WRITING(seen + 1));
#ifdef TWIN_ASK_LATEST
  ask = (there != WHOLE(seen + 1));
#endif
  if
  :: there == WHOLE(seen + 1) ->
    sequence_of(seen + 2);
    if
    :: there < WHOLE(seen + 2) -> count = seen + 1
    :: else -> ask = true
    fi
  :: else
  fi;
  if
  :: ask ->
    load(reader, LATEST, ORDER(acquire, TWIN_ASK_RELAXED), count);
    told = count;
#ifndef TWIN_ASK_LATEST
    count = MOST(count, seen);
#endif
    ask = false
  :: else
  fi
}

inline resume() {
  load(reader, LATEST, ORDER(acquire, TWIN_RESUME_RELAXED), count);
  told = count;
  if
  :: count != seen && count + 1 != seen -> seen = (count == 0 -> 0 : count - 1)
  :: else
  fi
}

inline note_finished() {
  d_step {
    count = 0;
    do
    :: count < SLOTS ->
      there = NEWEST(SEQUENCE(count));
      if
      :: there % 2 == 0 && there / 2 > finished ->
        finished = there / 2;
        finished_stamp = NEWEST(WORD(count, 0))
      :: else
      fi;
      count++
    :: else -> break
    od
  }
}

init {
  byte seen, idle, tries;
  bool ask;
  byte last; /* ghost: the value read last */
  byte told; /* ghost: the newest `latest` this reader has loaded */
  byte ends; /* ghost: reads since everything is visible */

  atomic {
alive:
    do
    :: stamp < WRITES ->
      stamp++;
      write()
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
    note_finished();
    count = 0;
    there = 0
  }

  do
  :: ends == 2 -> break
  :: ends < 2 ->
    if
    :: ends > 0 -> ends++
    :: ends == 0
    :: ends == 0 -> all_visible(reader); ends = 1
    fi;
again: /* read() */
    tries++;
    newest();
    if
    :: count == seen ->
      CLAIM(stale, seen >= told);
      idle = (idle + 1) % IDLE;
      if
      :: idle == 0 -> resume()
      :: else
      fi;
      goto done
    :: else
    fi;
    record_read(reader, SLOT(count), count);
    if
    :: !whole ->
      CLAIM(disturbed, there >= WHOLE(count + 4));
      if
      :: tries < TRIES -> goto again
      :: goto done /* given up */
      fi
    :: else
    fi;
    d_step {
      CLAIM(torn, got[0] == got[1]);
      CLAIM(backwards, got[0] > last);
      last = got[0];
      seen = count;
      idle = 0
    };
done:
    atomic {
      forget_known(reader);
      count = 0;
      there = 0;
      got[0] = 0;
      got[1] = 0;
      whole = false;
      tries = 0
    }
  od;
  CLAIM(lost, last == finished_stamp)
}
