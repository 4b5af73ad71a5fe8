/* SPDX-License-Identifier: Apache-2.0
 * Which process may write into which slot of the code arena, and when. Code: supervisor/link/spine/spine_link.cpp.
 *
 * Supervisor  stands for SpineLink::take_slot, give_back and stage, for Swaps::place and stage
 *             (supervisor/swap/swap.cpp), and for lawd, which writes the image (spine/arena/arena.cpp) while the swap
 *             waits for its answer. It may be killed at any point, and lawd with it; the next one adopts the Spine.
 * Loader      stands for Loader::poll, stage, release and publish_info (spine/load/loader.cpp) and for ArenaStore::load
 *             and unload (spine/load/arena_store.cpp). Letters may wait, and a law may be refused or released, at any
 *             time; how the tick releases it is in slot.pml.
 *
 * Memory. Mailbox and Channel order the accesses on both sides; channel.pml shows how.
 *
 * Constants: SLOTS instead of 16, PLACES instead of 8, LETTERS instead of 4. An image has 2 words.
 *
 * claim untouched  nobody writes to the slot of a law from its check by the Loader until its end
 * claim alone      two laws never have the same slot
 */
//: model
//: twin ADOPT_AT_ONCE        untouched  a new supervisor does not wait for the answers to its predecessor's letters
//: twin FORGET_UNANSWERED    untouched  a slot is free again although the Loader has yet to answer for it
//: twin LAWS_BEFORE_ANSWERS  untouched  take_slot() reads the laws first and the answers then
//: twin ANSWER_FIRST         untouched  the Loader answers before it has published the law
//: twin EMPTY_INFO_EARLY     untouched  the Loader publishes that a place is empty before the tick has let its law go

#define SLOTS 3
#define PLACES 2
#define LETTERS 2
#define TICKETS 3 /* of the letters, and of the one that the Loader reads */
#define KILLS 2
#define NONE 0

/* Between the processes: the Mailbox with its answers, and the LawInfo of each place. Slots and places count from 1. */
chan letters = [LETTERS] of { byte, byte }; /* ticket, slot */
bool answered[TICKETS] = true;
byte head;
byte info[PLACES + 1]; /* the slot of the law there */

/* The arena: whether each word of a slot is still that of the image in a letter. */
byte slot_in[TICKETS];
bool word0[TICKETS], word1[TICKETS];

/* ArenaStore::slots_ */
byte slot_of[PLACES + 1];

byte kills;
bool untouched, alone;
#define CLAIM(name, holds) assert(name || (holds))

/* lawd writes a word. Every image is different, so the image that was in the slot is no longer complete. */
#define WRITE(word, s) \
  d_step { \
    CLAIM(untouched, slot_of[1] != s && slot_of[2] != s); \
    i = 0; \
    do \
    :: i < TICKETS -> \
      if \
      :: slot_in[i] == s -> word[i] = false \
      :: else \
      fi; \
      i++ \
    :: else -> break \
    od; \
    i = 0 \
  }

#define MAY_DIE \
  if \
  :: kills < KILLS -> kills++; goto dead \
  :: true \
  fi

mtype = { unused, asked };

/* SpineLink::laws() */
inline read_laws() {
  i = 1;
  do
  :: i <= PLACES -> resident[info[i]] = true; i++
  :: else -> break
  od;
  resident[NONE] = false
}

/* Loader::release(), of a law that the tick has released */
inline release() {
#ifdef TWIN_EMPTY_INFO_EARLY
  info[p] = NONE;
#endif
  slot_of[p] = NONE;
  info[p] = NONE;
  p = 0
}

active proctype Supervisor() {
  mtype use[SLOTS + 1] = unused;
  byte ticket[SLOTS + 1];
  bool resident[SLOTS + 1];
  byte i, s;

alive:
#ifndef TWIN_ADOPT_AT_ONCE
  i = 0;
  do
  :: i < TICKETS -> answered[i]; i++
  :: else -> break
  od;
#endif

end_idle:
  do
  :: /* take_slot() */
#ifdef TWIN_LAWS_BEFORE_ANSWERS
    read_laws();
#endif
    i = 1;
    do
    :: i <= SLOTS ->
      if
#ifdef TWIN_FORGET_UNANSWERED
      :: use[i] == asked -> use[i] = unused; ticket[i] = 0
#endif
      :: use[i] == asked && answered[ticket[i]] -> use[i] = unused; ticket[i] = 0
      :: else
      fi;
      i++
    :: else -> break
    od;
#ifndef TWIN_LAWS_BEFORE_ANSWERS
    read_laws();
#endif
    atomic {
      s = 1;
      do
      :: s <= SLOTS && (resident[s] || use[s] != unused) -> s++
      :: s < SLOTS && !resident[s] && use[s] == unused -> s++ /* they are used in turn: any free one may be next */
      :: s <= SLOTS && !resident[s] && use[s] == unused -> break
      :: s > SLOTS -> break
      od;
      i = 1;
      do
      :: i <= SLOTS -> resident[i] = false; i++
      :: else -> i = 0; break
      od
    };
    if
    :: s > SLOTS -> s = 0; goto again
    :: else
    fi;
    MAY_DIE;
    /* lawd writes; the slot is taken */
    WRITE(word0, s);
    MAY_DIE;
    WRITE(word1, s);
    MAY_DIE;
    if /* stage() */
    :: atomic {
        nfull(letters) && answered[head] ->
        answered[head] = false;
        letters!head, s;
        slot_in[head] = s;
        word0[head] = true;
        word1[head] = true;
        use[s] = asked;
        ticket[s] = head;
        head = (head + 1) % TICKETS
      }
    :: true /* given up meanwhile, or the mailbox is full: give_back() */
    fi;
    MAY_DIE;
    s = 0;
again:
    skip
  od;

dead:
  atomic {
    i = 1;
    do
    :: i <= SLOTS -> use[i] = unused; ticket[i] = 0; resident[i] = false; i++
    :: else -> break
    od;
    s = 0;
    i = 0;
    goto alive
  }
}

active proctype Loader() {
  byte t, s, p;

end_idle:
  do
  :: letters ? t, s ->
    p = 1;
    do
    :: p <= PLACES && slot_of[p] != NONE -> p++
    :: else -> break
    od;
    /* ArenaStore::load(): the image may be a different or an incomplete one by now */
    if
    :: p > PLACES || slot_of[1] == s || slot_of[2] == s -> goto refused
    :: else
    fi;
    if
    :: !word0[t] -> goto refused
    :: else
    fi;
    if
    :: !word1[t] -> goto refused
    :: else
    fi;
    d_step {
      slot_of[p] = s;
      CLAIM(untouched, word0[t] && word1[t]);
      CLAIM(alone, slot_of[1] != slot_of[2])
    };
    if
    :: slot_of[p] = NONE; goto refused /* its rehearsal failed */
    :: true
    fi;
#ifdef TWIN_ANSWER_FIRST
    answered[t] = true;
#endif
    info[p] = s; /* publish_info() */
refused:
    atomic {
      answered[t] = true;
      slot_in[t] = NONE;
      word0[t] = false;
      word1[t] = false;
      t = 0;
      s = 0;
      p = 0
    }
  :: atomic { slot_of[1] != NONE -> p = 1 }; release()
  :: atomic { slot_of[2] != NONE -> p = 2 }; release()
  od
}
