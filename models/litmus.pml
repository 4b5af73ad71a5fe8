/* SPDX-License-Identifier: Apache-2.0
 * The memory of memory.inc itself, with litmus tests whose outcome under C++20 is known: what it forbids are the claims, what it
 * permits are the twins. Each search picks one test.
 *
 * claim passed    message passing: who finds the flag finds the data, by release and acquire, or by two fences
 * claim coherent  loads of one object never go backwards
 * claim once      of two exchanges, one finds what the other has left
 * claim buffered  of two threads that store one object and load the other's, one finds the other's store (sequentially
 *                 consistent memory only; so nothing but a twin says it)
 */
//: model
//: twin FLAG_STORE        passed    the flag is stored without release
//: twin FLAG_LOAD         passed    the flag is loaded without acquire
//: twin RELEASE_FENCE     passed    no fence before the store of the flag
//: twin ACQUIRE_FENCE     passed    no fence behind the load of the flag
//: twin STORED_AGAIN      passed    a relaxed store by the same thread, behind the release store, carries nothing (C++20)
//: twin LOAD_THEN_STORE   once      a load and a store are not an exchange
//: twin STORE_BUFFERING   buffered  the store of either thread may come behind its load

#define DATA 0
#define FLAG 1
#define OBJECTS 2
#define MESSAGES 3
#define USES 1
#include "memory.inc"

#define PASS_BY_ORDER 1
#define PASS_BY_FENCE 2
#define COHERENCE 3
#define EXCHANGE 4
#define BUFFERING 5

byte litmus, first, second, mine;

bool ended; /* what One does is done */

bool passed, coherent, once, buffered;

active proctype One() {
  if
  :: litmus = PASS_BY_ORDER;
    store(0, DATA, 1, relaxed);
    store(0, FLAG, 1, ORDER(release, TWIN_FLAG_STORE));
#ifdef TWIN_STORED_AGAIN
    store(0, FLAG, 1, relaxed)
#endif
  :: litmus = PASS_BY_FENCE;
    store(0, DATA, 1, relaxed);
    fence(0, ORDER(release, TWIN_RELEASE_FENCE));
    store(0, FLAG, 1, relaxed)
  :: litmus = COHERENCE;
    store(0, DATA, 1, relaxed);
    store(0, DATA, 2, relaxed)
  :: litmus = EXCHANGE;
#ifdef TWIN_LOAD_THEN_STORE
    load(0, DATA, relaxed, mine);
    store(0, DATA, 1, relaxed)
#else
    exchange(0, DATA, 1, relaxed, mine)
#endif
#ifdef TWIN_STORE_BUFFERING
  :: litmus = BUFFERING;
    store(0, DATA, 1, release);
    load(0, FLAG, acquire, mine)
#endif
  fi;
  ended = true
}

active proctype Two() {
  litmus != 0;
  if
  :: litmus == PASS_BY_ORDER ->
    load(1, FLAG, ORDER(acquire, TWIN_FLAG_LOAD), first);
    load(1, DATA, relaxed, second);
    CLAIM(passed, second >= first)
  :: litmus == PASS_BY_FENCE ->
    load(1, FLAG, relaxed, first);
    fence(1, ORDER(acquire, TWIN_ACQUIRE_FENCE));
    load(1, DATA, relaxed, second);
    CLAIM(passed, second >= first)
  :: litmus == COHERENCE ->
    load(1, DATA, relaxed, first);
    load(1, DATA, relaxed, second);
    CLAIM(coherent, second >= first)
  :: litmus == EXCHANGE ->
    exchange(1, DATA, 1, relaxed, first);
    ended;
    CLAIM(once, first + mine == 1)
#ifdef TWIN_STORE_BUFFERING
  :: litmus == BUFFERING ->
    store(1, FLAG, 1, release);
    load(1, DATA, acquire, first);
    ended;
    CLAIM(buffered, first + mine > 0)
#endif
  fi
}
