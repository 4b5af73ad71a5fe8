/* SPDX-License-Identifier: Apache-2.0
 * The double buffer between the tick and the Transport. Code: spine/loop/handover.hpp.
 *
 * Tick       stands for Spine::exchange, look and compose (spine/loop/tick.cpp) with Handover::idle, latest_sample,
 *            dispatch and next_command; its loop never ends.
 * Transport  stands for run_transport and serve_once (spine/loop/transport.cpp) with pending, command, sample, finish.
 *            It may be late by any number of ticks, and hang forever at any point.
 *
 * Memory. SPIN is sequentially consistent. The code's release stores do not delay later stores: the words of
 * the next command may become visible before the dispatch of this one. This is in the model; the reorderings that the orders
 * forbid are the twins FINISH_BEFORE_SAMPLE and DISPATCH_BEFORE_FILL.
 *
 * Constants: a buffer has 2 words. Counters and stamps count modulo 4 and 8: the two sides differ by at most one (this
 * is a claim, too), so values are never confused, and the model runs without end in finitely many states.
 *
 * claim torn       a command or sample that is read is one that was written as a whole
 * claim order      commands are applied in the order of their dispatch, each exactly once
 * claim answer     the sample that the tick uses answers the command it dispatched last, and does not change meanwhile
 * claim apart      the counters never differ by more than one
 * claim endstate   (SPIN's own) the tick never waits: it continues when the Transport hangs
 */
//: model
//: twin DO_NOT_ASK            apart     a late Transport gets the next command nevertheless
//: twin ONE_BUFFER            torn      one buffer a side instead of two
//: twin SAMPLE_OF_NEXT        torn      latest_sample() is the buffer the Transport writes to
//: twin DISPATCH_BEFORE_FILL  torn      a command is dispatched before its last word (no release store)
//: twin FINISH_BEFORE_SAMPLE  torn      `done` is stored before the last word of the sample (no release store)
//: twin FORGET_FINISHED       order     the Transport does not count what it has done, and does it again
//: twin WAIT_FOR_TRANSPORT    endstate  a tick waits until the Transport is idle

#define NEXT(counter) (((counter) + 1) % 4)
#ifdef TWIN_ONE_BUFFER
#define SLOT(counter) 0
#else
#define SLOT(counter) ((counter) & 1)
#endif

/* Handover. */
byte dispatched, done;
byte command0[2], command1[2];
byte state0[2], state1[2];

/* Only in the model, not in the code. */
byte ordered; /* stamp of the command dispatched last */
byte orders;  /* dispatched and not yet applied */

bool torn, order, answer, apart;
#define CLAIM(name, holds) assert(name || (holds))

active proctype Tick() {
  byte sent;         /* sent_ */
  byte sample;       /* sample_ points to this buffer */
  byte stamp;        /* of the command composed last; the n-th is n modulo 8 */
  byte sent_stamp;   /* of the command dispatched last */
  byte expected;     /* stamp of the command that `sample` answers */
  bool fresh, early; /* early: a word of the next command is there already */
  byte got0, got1;

  do
  :: /* exchange() */
#ifdef TWIN_WAIT_FOR_TRANSPORT
    done == sent;
#endif
    fresh = (done == sent);
#ifdef TWIN_DO_NOT_ASK
    fresh = true;
#endif
    if
    :: !fresh
    :: else ->
#ifdef TWIN_SAMPLE_OF_NEXT
      sample = SLOT(NEXT(sent));
#else
      sample = SLOT(sent);
#endif
      expected = sent_stamp;
      if
      :: early = true; command0[SLOT(NEXT(NEXT(sent)))] = (stamp + 1) % 8
      :: early = false
      fi;
      d_step {
        sent = NEXT(sent);
        dispatched = sent;
        sent_stamp = stamp;
        ordered = stamp;
        orders++;
        CLAIM(apart, orders <= 1)
      }
#ifdef TWIN_DISPATCH_BEFORE_FILL
      command1[SLOT(sent)] = stamp;
#endif
    fi;

    /* look(), publish(): the tick uses the sample until its end; a late tick still uses that of an earlier tick. */
    got0 = state0[sample];
    got1 = state1[sample];
    d_step {
      CLAIM(torn, got0 == got1);
      CLAIM(answer, got0 == expected);
      got0 = 0;
      got1 = 0
    }

    /* compose(): also when the one before was not sent yet; it is overwritten. */
    stamp = (stamp + 1) % 8;
    if
    :: early -> early = false
    :: else -> command0[SLOT(NEXT(sent))] = stamp
    fi;
#ifndef TWIN_DISPATCH_BEFORE_FILL
    command1[SLOT(NEXT(sent))] = stamp
#endif
  od
}

/* The Transport may hang here forever. */
#define MAY_HANG \
  if \
  :: goto end_hung \
  :: true \
  fi

active proctype Transport() {
  byte finished; /* finished_ */
  byte got0, got1;

end_idle:
  do
  :: dispatched != finished -> /* pending() */
    MAY_HANG;
    got0 = command0[SLOT(NEXT(finished))];
    MAY_HANG;
    got1 = command1[SLOT(NEXT(finished))];
    d_step {
      CLAIM(torn, got0 == got1);
      CLAIM(order, orders == 1 && got0 == ordered);
      orders--;
      got1 = 0
    }
    MAY_HANG;
    state0[SLOT(NEXT(finished))] = got0;
    MAY_HANG;
#ifndef TWIN_FINISH_BEFORE_SAMPLE
    state1[SLOT(NEXT(finished))] = got0;
    MAY_HANG;
#endif
#ifdef TWIN_FORGET_FINISHED
    done = NEXT(finished);
#else
    d_step { finished = NEXT(finished); done = finished }
#endif
#ifdef TWIN_FINISH_BEFORE_SAMPLE
    state1[SLOT(finished)] = got0;
#endif
    got0 = 0
  od;
end_hung:
  false
}
