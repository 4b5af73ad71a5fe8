/* SPDX-License-Identifier: Apache-2.0
 * The way of a law from the Loader to the tick and back. Code: spine/law/slot.hpp.
 *
 * Loader  stands for Loader::poll, retire_one, candidate_waits, stage, prepare and release (spine/load/loader.cpp) with
 *         Slot::collect_retired, active_id, withdraw and offer. Time-outs and refused loads come whenever they like.
 * Tick    stands for what Laws does in one tick (spine/step/listen.cpp, laws.cpp, step.cpp): roll_back, step, replace,
 *         check_probation, swap, step_shadow, end_shadow, commit; with Slot::take, commit, refuse and rollback(n).
 *         Faults, commands and opinions come whenever they like.
 *
 * A law's code belongs to its place: statements about a place are also true for its arena slot, which the Loader frees
 * (LawStore::unload) together with the place.
 *
 * Memory. SPIN is sequentially consistent. With the orders in the code, every use of a Resident is between the two
 * accesses that hand it over: slot_order.pml shows this.
 *
 * Constants: HISTORY 2 instead of 4, and the fewest PLACES that slot.hpp allows for it. In the code, law ids increase
 * without end. Here a law's id is its place, and when the place is free, an `active_id` with this id is set to NO_MORE: it
 * equals no id, as in the code.
 *
* claim one_owner  who reads, writes or hands over a Resident owns it; so it has one owner at a time
 * claim whole      a law that runs was filled completely, and its code is loaded
 * claim offered    an offer finds the slot empty (the Loader drops the result)
 * claim room       there is a free place for each request
 * claim lost       once the tick has stopped, each place is free but those of the active law, of those before it, and of
 *                  the one in the shadow
 */
//: model
//: twin LOAD_THEN_STORE         one_owner  take() loads and then stores instead of exchanging
//: twin WITHDRAW_BY_STORE       one_owner  withdraw() loads and then stores instead of exchanging
//: twin RELEASE_ON_TIMEOUT      one_owner  the Loader takes a late candidate back without asking the slot
//: twin PUBLISH_BEFORE_FILL     whole      a candidate is offered before it is filled
//: twin RETIRE_BEFORE_CARRY     one_owner  rollback() retires the law before it has read its state
//: twin RETIRE_WITHOUT_WAITING  one_owner  the Loader unloads the old law as soon as it sees the new one active
//: twin REFUSE_AND_KEEP         lost       the shadow is not ended when its law is refused
//: twin FORGET_PASSED_OVER      lost       rollback(n) does not retire the laws it passes over
//: twin FORGET_OLDEST           lost       commit() drops the oldest law instead of retiring it
//: twin DO_NOT_WAIT             offered    the Loader stages the next law before the last one has its tick
//: twin ID_IS_PLACE             offered    a law's id is that of its place
//: twin TOO_FEW_PLACES          room       one place fewer

#ifndef HISTORY
#define HISTORY 2
#endif
#ifdef TWIN_TOO_FEW_PLACES
#define PLACES (HISTORY + 2)
#else
#define PLACES (HISTORY + 3)
#endif

/* Residents are numbered from 1; 0 is the null pointer. */
#define NONE 0
#define NO_MORE 255

/* Slot. */
byte pending;
byte retired[PLACES + 1];
byte active_id;
byte active_;              /* the tick's own, down to depth */
byte history[HISTORY];
byte depth;
byte shadow;               /* Shadow::law_, the tick's own */

/* Resident, and its code. */
bool used[PLACES + 1];     /* Loader::used_ */
bool code[PLACES + 1];     /* loaded in the LawStore */
bool filled[PLACES + 1];

/* Only in the model, not in the code. */
mtype = { loader, slot, tick };
mtype owner[PLACES + 1] = loader;
bool stop, tick_stopped;

bool one_owner, whole, offered, room, lost;
#define CLAIM(name, holds) assert(name || (holds))
#define OWNS(who, r) CLAIM(one_owner, owner[r] == who)

#define USE(r) d_step { OWNS(tick, r); CLAIM(whole, code[r] && filled[r]) }

inline retire(r) {
  d_step {
    OWNS(tick, r);
    CLAIM(one_owner, retired[r] == NONE);
    owner[r] = slot;
    retired[r] = r
  }
}

inline make_active(r) {
  active_ = r;
  active_id = r
}

/* What Slot::rollback(n) does to the tick's own list. */
inline shift_history(n) {
  d_step {
    depth = depth - n;
    i = 0;
    do
    :: i < HISTORY -> history[i] = (i < depth -> history[i + n] : NONE); i++
    :: else -> break
    od;
    i = 0
  }
}

/* Spine::roll_back(): Slot::rollback(named, n) */
inline roll_back(n) {
  target = history[n - 1];
#ifdef TWIN_RETIRE_BEFORE_CARRY
  retire(active_);
#endif
  USE(active_);
  USE(target);
#ifndef TWIN_RETIRE_BEFORE_CARRY
  retire(active_);
#endif
#ifndef TWIN_FORGET_PASSED_OVER
  i = 0;
  do
  :: i + 1 < n -> retire(history[i]); i++
  :: else -> break
  od;
  i = 0;
#endif
  shift_history(n);
  make_active(target);
  target = NONE
}

/* Spine::replace_law(): Slot::rollback(none, 1) */
inline replace_law() {
  failed = true;
  if
  :: depth > 0 ->
    target = history[0];
    retire(active_);
    shift_history(1);
    make_active(target);
    target = NONE;
    USE(active_)
  :: else /* safe stop; the law stays where it is */
  fi
}

/* Spine::commit() with Slot::commit() */
inline commit(r) {
  if
  :: active_ != NONE ->
    USE(r);
    USE(active_); /* carry_into() */
    if
    :: depth == HISTORY ->
      depth--;
#ifndef TWIN_FORGET_OLDEST
      retire(history[depth])
#endif
    :: else
    fi;
    d_step {
      i = depth;
      do
      :: i > 0 -> history[i] = history[i - 1]; i--
      :: else -> break
      od;
      history[0] = active_;
      depth++
    }
  :: else
  fi;
  make_active(r);
  USE(active_)
}

active proctype Tick() {
  byte candidate, target, n, i;
  bool failed; /* flags_ & (kRolledBack | kLawFaulted) */

  do
  :: stop -> break
  :: else ->
    failed = false;
    if /* listen(): roll_back() */
    :: depth > 0 ->
      n = 1;
      do
      :: n < depth -> n++
      :: break
      od;
      roll_back(n);
      n = 0;
      failed = true
    :: true
    fi;
    if /* step_law() */
    :: active_ != NONE ->
      USE(active_);
      if
      :: replace_law();
        if
        :: depth > 0 -> replace_law()
        :: true
        fi
      :: true
      fi
    :: else
    fi;
    if /* check_probation() */
    :: active_ != NONE ->
      USE(active_);
      if
      :: replace_law()
      :: true
      fi
    :: else
    fi;
    if /* swap() */
    :: shadow != NONE -> /* step_shadow() */
      USE(shadow);
      if
      :: d_step { candidate = shadow; shadow = NONE };
#ifdef TWIN_REFUSE_AND_KEEP
        shadow = candidate;
#endif
        retire(candidate) /* refuse() */
      :: !failed -> candidate = shadow; shadow = NONE; commit(candidate)
      :: !failed
      fi
    :: else -> /* take() */
      candidate = pending;
      if
      :: candidate != NONE ->
        atomic {
#ifndef TWIN_LOAD_THEN_STORE
          candidate = pending;
#endif
          pending = NONE;
          if
          :: candidate != NONE -> CLAIM(one_owner, owner[candidate] == slot); owner[candidate] = tick
          :: else
          fi
        }
      :: else
      fi;
      if
      :: candidate != NONE ->
        if
        :: USE(candidate); shadow = candidate /* start_shadow() */
        :: commit(candidate)
        fi
      :: else
      fi
    fi;
    candidate = NONE
  od;
  tick_stopped = true
}

/* Loader::release() */
inline release(r) {
  OWNS(loader, r);
  d_step { code[r] = false; filled[r] = false };
  OWNS(loader, r);
  d_step {
#ifndef TWIN_ID_IS_PLACE
    if
    :: active_id == r -> active_id = NO_MORE
    :: else
    fi;
#endif
    used[r] = false;
    r = NONE
  }
}

/* Slot::collect_retired(). Only the Loader empties a place, so a law that it has seen there is still there. */
inline collect_retired() {
  i = 1;
  do
  :: i > PLACES -> break
  :: i <= PLACES && retired[i] == NONE -> i++
  :: i <= PLACES && retired[i] != NONE ->
    atomic {
      gone = retired[i];
      retired[i] = NONE;
      CLAIM(one_owner, owner[gone] == slot);
      owner[gone] = loader;
      break
    }
  od;
  i = 0
}

/* Slot::withdraw() */
inline withdraw() {
#ifdef TWIN_WITHDRAW_BY_STORE
  gone = pending;
#endif
  atomic {
#ifndef TWIN_WITHDRAW_BY_STORE
    gone = pending;
#endif
    pending = NONE;
    if
    :: gone != NONE -> CLAIM(one_owner, owner[gone] == slot); owner[gone] = loader
    :: else
    fi
  }
}

active proctype Loader() {
  byte waiting, gone, place, i;
#ifdef TWIN_RETIRE_WITHOUT_WAITING
  byte running;
#endif

  do
  :: stop = true; break
  :: /* poll(): retire_one() */
    collect_retired();
    if
    :: gone != NONE ->
      if
      :: gone == waiting -> waiting = NONE
      :: else
      fi;
      release(gone);
      goto next
    :: else
    fi;
    if /* candidate_waits() */
    :: waiting != NONE ->
      if
      :: active_id == waiting ->
#ifdef TWIN_RETIRE_WITHOUT_WAITING
        if
        :: running != NONE -> release(running)
        :: else
        fi;
        running = waiting;
#endif
        waiting = NONE
      :: else ->
        if
#ifdef TWIN_DO_NOT_WAIT
        :: waiting = NONE
#endif
        :: goto next
        :: /* time-out */
#ifdef TWIN_RELEASE_ON_TIMEOUT
          gone = waiting;
#else
          withdraw();
#endif
          if
          :: gone == NONE -> goto next
          :: else -> waiting = NONE; release(gone)
          fi
        fi
      fi
    :: else
    fi;
    if /* receive() */
    :: goto next
    :: /* stage(): free_resident(), prepare() */
      place = 1;
      do
      :: place <= PLACES && used[place] -> place++
      :: else -> break
      od;
      CLAIM(room, place <= PLACES);
      OWNS(loader, place);
      code[place] = true;
      if
      :: code[place] = false; place = NONE; goto next /* the law is refused */
      :: true
      fi;
      OWNS(loader, place);
#ifndef TWIN_PUBLISH_BEFORE_FILL
      filled[place] = true;
#endif
      used[place] = true;
      waiting = place;
      d_step { /* offer() */
        OWNS(loader, place);
        CLAIM(offered, pending == NONE);
        pending = place;
        owner[place] = slot
      };
#ifdef TWIN_PUBLISH_BEFORE_FILL
      filled[place] = true;
#endif
      place = NONE
    fi;
next:
    skip
  od;

  tick_stopped;
  withdraw();
  if
  :: gone != NONE -> release(gone)
  :: else
  fi;
  do
  :: collect_retired();
    if
    :: gone != NONE -> release(gone)
    :: else -> break
    fi
  od;
  i = 1;
  d_step {
    do
    :: i <= PLACES ->
      if
      :: used[i] -> CLAIM(lost, owner[i] == tick); place++
      :: else
      fi;
      i++
    :: else -> break
    od;
    CLAIM(lost, place == (active_ != NONE) + depth + (shadow != NONE))
  }
}
