/* SPDX-License-Identifier: Apache-2.0
 * The four-slot Channel. Code: spine/ipc/channel.hpp, its records: spine/ipc/words.hpp.
 *
 * Writer  stands for ChannelWriter::write and Record::write, of a process that may die between any two stores; then
 *         another one continues with the contents of the memory (the lease of the segment orders the two).
 * Reader  stands for ChannelReader::read, newest and resume and for Record::read. Readers store nothing that others
 *         load, so one reader in the model stands for many.
 *
 * Memory. SPIN executes every store and load in order (SC). The orders in the code permit three reorderings, and
 * all three are in the model: the writer's words among each other, the reader's words among each other, and the odd
 * mark of the next value, which may become visible before the announcement of this one (a release store
 * does not delay later stores). Reorderings that the code forbids are twins below. When a writer dies after a store,
 * all its earlier stores are done: they become visible before its successor starts.
 *
 * Constants: a value has 2 words, not up to 500; a reader gives up after TRIES, asks `latest` after IDLE.
 *
 * claim torn       a read that succeeds gives words of one value only
 * claim backwards  each value read is younger than the one before
 * claim stale      after a read that was not given up, the reader has the newest announced value or a newer one
 * claim disturbed  a copy of the newest value fails only when the writer has written three more values meanwhile
 * claim blocked    a read ends after TRIES tries, whatever the writer does or has left in memory
 * claim lost       after the last write, a reader has the newest whole value after two reads
 */
//: model -DWRITES=8 -DKILLS=1
//: model -DWRITES=7 -DKILLS=2
//: twin ONE_LOOK             torn       read() does not look at the sequence again after the copy
//: twin LOOK_BEFORE_COPY     torn       that look comes before the last word (no acquire fence)
//: twin NO_MARK              torn       write() does not mark the record odd
//: twin WORD_BEFORE_MARK     torn       a word is stored before the mark (no release fence)
//: twin NUMBER_BEFORE_VALUE  torn       the even sequence is stored before the last word (no release store)
//: twin ANNOUNCE_BEFORE_FILL stale      `latest` is stored before the record is written
//: twin THREE_SLOTS          disturbed  three slots instead of four
//: twin SAME_NUMBER          lost       a successor writes a finished number again
//: twin SKIP_UNANNOUNCED     backwards  a successor skips a finished number and does not announce it
//: twin ASK_LATEST           backwards  a reader trusts `latest` more than the records
//: twin WAIT_WHILE_ODD       blocked    a reader waits for a record to be finished, as with a plain seqlock

#ifdef TWIN_THREE_SLOTS
#define SLOTS 3
#else
#define SLOTS 4
#endif
#ifndef WRITES
#define WRITES 7 /* begun by all writers together */
#endif
#ifndef KILLS
#define KILLS 2
#endif
#define TRIES 2
#define IDLE 2

#define SLOT(count) ((count) % SLOTS)

/* The segment: ChannelMemory. */
byte latest;
byte sequence[SLOTS];
byte word0[SLOTS];
byte word1[SLOTS];

/* Only in the model, not in the code. Every write() has its own stamp, which stands for its value. */
byte stamp;          /* of the write begun last */
byte finished;       /* number of the newest value whose even sequence has been stored */
byte finished_stamp; /* and which value that is */
byte kills;
bool writers_gone;

/* A claim that fails shows its name in SPIN's message. These stay 0. */
bool torn, backwards, stale, disturbed, blocked, lost;
#define CLAIM(name, holds) assert(name || (holds))

/* One store, and perhaps the last of this writer. */
#define STORE(what) \
  atomic { \
    what; \
    if \
    :: kills < KILLS && !early -> kills++; goto dead \
    :: true \
    fi \
  }

/* The mark of the next record may be visible already. It was stored after all of this write, so this writer lives. */
#define MARK_OF_NEXT_MAY_SHOW \
  if \
  :: stamp < WRITES && !early -> \
    d_step { \
      early = true; \
      sequence[SLOT(count + 1)] = 2 * (count + 1) + 1; \
      finished = count; \
      finished_stamp = stamp \
    } \
  :: true \
  fi

active proctype Writer() {
  byte count;
  bool early, word0_done;

alive:
  do
  :: stamp < WRITES ->
    d_step { stamp++; count = latest + 1 }
    if
#ifndef TWIN_SAME_NUMBER
    :: sequence[SLOT(count)] == 2 * count ->
      /* This one begins with its mark, which may become visible before the announcement of the value before. */
      if
      :: !early -> early = true; sequence[SLOT(count + 1)] = 2 * (count + 1) + 1
      :: true
      fi;
#ifndef TWIN_SKIP_UNANNOUNCED
      STORE(latest = count);
#endif
      count++
#endif
    :: else
    fi;
#ifdef TWIN_ANNOUNCE_BEFORE_FILL
    STORE(latest = count);
#endif
#ifdef TWIN_WORD_BEFORE_MARK
    STORE(word0[SLOT(count)] = stamp);
#endif
    if
    :: early -> early = false
    :: else ->
#ifndef TWIN_NO_MARK
      STORE(sequence[SLOT(count)] = 2 * count + 1)
#endif
    fi;
    if
    :: word0_done = true; STORE(word0[SLOT(count)] = stamp)
    :: word0_done = false
    fi;
    MARK_OF_NEXT_MAY_SHOW;
#ifdef TWIN_NUMBER_BEFORE_VALUE
    STORE(sequence[SLOT(count)] = 2 * count; finished = count; finished_stamp = stamp);
#endif
    STORE(word1[SLOT(count)] = stamp);
    if
    :: !word0_done -> STORE(word0[SLOT(count)] = stamp)
    :: else -> word0_done = false
    fi;
    MARK_OF_NEXT_MAY_SHOW;
#ifndef TWIN_NUMBER_BEFORE_VALUE
    STORE(sequence[SLOT(count)] = 2 * count; finished = count; finished_stamp = stamp);
#endif
    MARK_OF_NEXT_MAY_SHOW;
#ifndef TWIN_ANNOUNCE_BEFORE_FILL
    STORE(latest = count)
#endif
  :: !early -> goto gone /* the writer is done */
  od;

dead:
  atomic {
    count = 0;
    word0_done = false;
    if
    :: goto alive /* its successor */
    :: goto gone
    fi
  }
gone:
  writers_gone = true
}

active proctype Reader() {
  byte seen, idle;
  byte count, there, got0, got1, tries;
  byte last;  /* ghost: the value read last */
  byte floor; /* ghost: `latest` when this read began */
  byte reads_when_gone;

  do
  :: reads_when_gone == 2 -> break
  :: reads_when_gone < 2 ->
    atomic {
      if
      :: writers_gone -> reads_when_gone++
      :: else
      fi;
      floor = latest;
      tries = 0
    }
again:
    if
    :: tries == TRIES -> count = 0; goto done /* given up */
    :: else -> tries++
    fi;

    /* newest() */
#ifdef TWIN_WAIT_WHILE_ODD
    do
    :: there = sequence[SLOT(seen + 1)];
      CLAIM(blocked, tries < 4 * TRIES);
      if
      :: there == 2 * (seen + 1) + 1 -> tries++
      :: else -> break
      fi
    od;
#else
    there = sequence[SLOT(seen + 1)];
#endif
    if
#ifdef TWIN_ASK_LATEST
    :: there < 2 * (seen + 1) || there == 2 * (seen + 1) + 1 -> count = latest
#else
    :: there < 2 * (seen + 1) || there == 2 * (seen + 1) + 1 -> count = seen
#endif
    :: there == 2 * (seen + 1) ->
      there = sequence[SLOT(seen + 2)];
      if
      :: there < 2 * (seen + 2) -> count = seen + 1
      :: else -> count = latest; count = (count > seen -> count : seen)
      fi
    :: else -> count = latest; count = (count > seen -> count : seen)
    fi;

    if
    :: count == seen ->
      CLAIM(stale, seen >= floor);
      idle = (idle + 1) % IDLE;
      if
      :: idle == 0 -> /* resume() */
        there = latest;
        if
        :: there != seen && there + 1 != seen -> seen = (there == 0 -> 0 : there - 1)
        :: else
        fi
      :: else
      fi;
      goto done
    :: else
    fi;

    /* Record::read() */
    there = sequence[SLOT(count)];
    if
    :: there != 2 * count -> goto failed
    :: else
    fi;
    if
    :: got0 = word0[SLOT(count)];
#ifdef TWIN_LOOK_BEFORE_COPY
      there = sequence[SLOT(count)];
#endif
      got1 = word1[SLOT(count)]
    :: got1 = word1[SLOT(count)];
#ifdef TWIN_LOOK_BEFORE_COPY
      there = sequence[SLOT(count)];
#endif
      got0 = word0[SLOT(count)]
    fi;
#if !defined(TWIN_LOOK_BEFORE_COPY) && !defined(TWIN_ONE_LOOK)
    there = sequence[SLOT(count)];
#endif
    if
    :: there != 2 * count -> goto failed
    :: else
    fi;

    d_step {
      CLAIM(torn, got0 == got1);
      CLAIM(backwards, got0 > last);
      CLAIM(stale, count >= floor);
      last = got0;
      seen = count;
      idle = 0
    }
    goto done;
failed:
    atomic {
      CLAIM(disturbed, finished >= count + 3);
      count = 0;
      there = 0;
      got0 = 0;
      got1 = 0;
      goto again
    };
done:
    atomic { count = 0; there = 0; got0 = 0; got1 = 0; tries = 0; floor = 0 }
  od;
  CLAIM(lost, last == finished_stamp)
}
