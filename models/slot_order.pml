/* SPDX-License-Identifier: Apache-2.0
 * The memory orders of the exchange point between Loader and tick. Code: spine/law/slot.hpp. What the two do with it, without
 * end, is in slot.pml, which is sequentially consistent; here they do it for a few laws.
 *
 * Loader  stands for Loader::poll (spine/load/loader.cpp) with Slot::collect_retired, active_id, withdraw and offer.
 * Tick    stands for what a tick does with Slot::take, commit, refuse and rollback.
 *
 * Constants: LAWS laws, one at a time in `history`, RESIDENTS places.
 *
 * claim race     the last use of a Resident by one thread happens before the next one by the other
 * claim offered  an offer finds the slot empty (the Loader drops the result)
 * claim kept     a law is retired to an empty place
 *
 * Stronger than needed: the acquire of withdraw(). It finds the Loader's own store, or the null of take(), which hands nothing over.
 */
//: code spine/law/slot.hpp Slot::offer offer
//: code spine/law/slot.hpp Slot::withdraw withdraw
//: code spine/law/slot.hpp Slot::collect_retired collect_retired
//: code spine/law/slot.hpp Slot::active_id active_law
//: code spine/law/slot.hpp Slot::take take
//: code spine/law/slot.hpp Slot::retire retire
//: code spine/law/slot.hpp Slot::make_active make_active
//: model
//: model -DSPARE_WITHDRAW
//: twin OFFER_RELAXED    race     offer() publishes a candidate without release
//: twin TAKE_RELAXED     race     take() gets it without acquire
//: twin RETIRE_RELAXED   race     retire() hands a law back without release
//: twin COLLECT_RELAXED  race     collect_retired() gets it without acquire
//: twin ACTIVE_RELAXED   offered  make_active() stores the id without release
//: twin ID_RELAXED       offered  active_id() loads it without acquire

#define LAWS 3
#define RESIDENTS 3

/* Slot. Residents are numbered from 1; 0 is the null pointer. */
#define NONE 0
#define PENDING 0
#define ACTIVE_ID 1
#define RETIRED(r) (1 + (r))
#define OBJECTS (2 + RESIDENTS)
#define MESSAGES (3 * LAWS + 1)
#define USES (RESIDENTS + 1)
#include "memory.inc"

#define loader 0
#define tick 1

byte law_id[RESIDENTS + 1]; /* Resident::law_id: set before the offer, then constant */
bool used[RESIDENTS + 1];   /* Loader::used_ */

bool race, offered, kept;

#define USE(me, r) CLAIM(race, HAPPENED(me, r)); use(me, r)

/* Its failure would be a relaxed load: it fails when there is any other message that this could read. */
inline compare_exchange(me, object, expected, what, success, failure) {
  d_step {
    chosen = memory[object].top;
    do
    :: chosen > thread[me].seen[object] && !KNOWN(me, object, chosen) ->
      CLAIM(offered, memory[object].holds[chosen] == expected);
      chosen--
    :: else -> break
    od;
    CLAIM(offered, memory[object].holds[chosen] == expected);
    chosen = 0;
    append(me, object, what, success)
  }
}

inline offer(candidate) {
  compare_exchange(loader, PENDING, NONE, candidate, ORDER(release, TWIN_OFFER_RELAXED), relaxed)
}

inline withdraw(into) {
  exchange(loader, PENDING, NONE, ORDER(acquire, SPARE_WITHDRAW), into)
}

inline collect_retired(into) {
  place = 1;
  do
  :: place <= RESIDENTS ->
    load(loader, RETIRED(place), relaxed, into);
    if
    :: into != NONE -> exchange(loader, RETIRED(place), NONE, ORDER(acquire, TWIN_COLLECT_RELAXED), into); break
    :: else -> place++
    fi
  :: else -> break
  od;
  place = 0
}

inline active_law(into) {
  load(loader, ACTIVE_ID, ORDER(acquire, TWIN_ID_RELAXED), into)
}

inline take(into) {
  load(tick, PENDING, relaxed, into);
  if
  :: into != NONE -> exchange(tick, PENDING, NONE, ORDER(acquire, TWIN_TAKE_RELAXED), into)
  :: else
  fi
}

inline retire(r) {
  CLAIM(kept, NEWEST(RETIRED(r)) == NONE);
  store(tick, RETIRED(r), r, ORDER(release, TWIN_RETIRE_RELAXED))
}

inline make_active(r) {
  active_ = r;
  store(tick, ACTIVE_ID, law_id[r], ORDER(release, TWIN_ACTIVE_RELAXED))
}

active proctype Tick() {
  byte candidate, active_, before;

  do
  :: take(candidate);
    if
    :: candidate != NONE ->
      USE(tick, candidate);
      if
      :: /* commit() */
        if
        :: active_ != NONE ->
          USE(tick, active_);
          if
          :: before != NONE -> retire(before)
          :: else
          fi;
          before = active_
        :: else
        fi;
        make_active(candidate)
      :: retire(candidate) /* refuse() */
      fi;
      candidate = NONE
    :: else
    fi
  :: before != NONE -> /* rollback() */
    USE(tick, active_);
    USE(tick, before);
    retire(active_);
    make_active(before);
    before = NONE
  od
}

active proctype Loader() {
  byte waiting, gone, place, laws, id;
  bool late; /* the tick was faster than withdraw(): it will tell */

  do
  :: collect_retired(gone); /* retire_one(), release() */
    if
    :: gone != NONE ->
      USE(loader, gone);
      d_step {
        used[gone] = false;
        waiting = (gone == waiting -> NONE : waiting);
        gone = NONE
      }
    :: else
    fi
  :: waiting != NONE -> /* candidate_waits() */
    active_law(id);
    waiting = (id == law_id[waiting] -> NONE : waiting);
    id = 0
  :: waiting != NONE && !late -> /* time-out */
    withdraw(gone);
    late = (gone == NONE);
    if
    :: gone != NONE ->
      USE(loader, gone);
      d_step {
        used[gone] = false;
        gone = NONE;
        waiting = NONE
      }
    :: else
    fi
  :: waiting == NONE && laws < LAWS -> /* stage(), prepare() */
    place = 1;
    do
    :: used[place] -> place++
    :: else -> break
    od;
    USE(loader, place);
    laws++;
    law_id[place] = laws;
    used[place] = true;
    waiting = place;
    late = false;
    offer(place);
    place = 0
  od
}
