/* SPDX-License-Identifier: Apache-2.0
 * The Mailbox: letters one way, answers the other. Code: spine/ipc/mailbox.hpp, its records: spine/ipc/words.hpp.
 *
 * Sender    stands for MailboxSender::send, last_ticket and poll, and for one deed of a hostile sender: its head jumps.
 * Receiver  stands for the constructor of MailboxReceiver (letters are there already, or not), receive and answer.
 *
 * Each function loads first and stores last, so each is one atomic step (memory.inc).
 *
 * Constants: 2 letters of 2 words wait at most.
 *
 * claim torn     a letter that is received is one whole letter, and the one of its ticket
 * claim lost     an announced letter is received: it is never taken for an incomplete one
 * claim reused   a letter is overwritten only after the receiver has copied it (happens-before)
 * claim answer   who finds an answer also finds what the receiver did before it (happens-before)
 * claim endstate (SPIN's own) nobody waits
 *
 * Stronger than needed: what the constructor does. The letters that it drops are read by nobody, so their order is of no matter. And a
 * letter is read only after its number was acquired from `head`: the orders of its own sequence add nothing here.
 */
//: code spine/ipc/mailbox.hpp MailboxSender::send send
//: code spine/ipc/mailbox.hpp MailboxSender::last_ticket last_ticket
//: code spine/ipc/mailbox.hpp MailboxSender::poll poll
//: code spine/ipc/mailbox.hpp MailboxReceiver::MailboxReceiver start
//: code spine/ipc/mailbox.hpp MailboxReceiver::receive receive
//: code spine/ipc/mailbox.hpp MailboxReceiver::answer reply
//: model
//: model -DSPARE_START -DSPARE_FIRST_TAIL -DSPARE_READ -DTWIN_EVEN_RELAXED -DTWIN_NO_RELEASE_FENCE -DTWIN_NO_ACQUIRE_FENCE
//: twin HEAD_RELAXED        lost    `head` is stored without release
//: twin RECEIVE_RELAXED     lost    receive() loads `head` without acquire
//: twin TAIL_RELAXED        reused  `tail` is stored without release
//: twin SKIP_RELAXED        reused  `tail` is stored without release after a jump of the head
//: twin SEND_RELAXED        reused  send() loads `tail` without acquire
//: twin ANSWER_RELAXED      answer  the answer is stored without release
//: twin POLL_RELAXED        answer  poll() loads the answer without acquire
//: twin TAIL_BEFORE_COPY    reused  receive() stores `tail` before it copies the letter

#define RECORDS 2
#define LETTERS 4 /* sent as they should */
#define MOST_TICKETS (LETTERS + RECORDS + 1)

/* MailboxMemory and AckMemory */
#define HEAD 0
#define TAIL 1
#define SEQUENCE(slot) (2 + (slot))
#define WORD(slot, word) (2 + RECORDS + WORDS * (slot) + (word))
#define RESULT(slot) (2 + RECORDS + WORDS * RECORDS + (slot))
#define WORDS 2
#define OBJECTS (2 + RECORDS + WORDS * RECORDS + RECORDS)
#define MESSAGES (LETTERS + 3)
/* The copy of a letter, by slot; what is done for a letter, by ticket. */
#define DONE(ticket) (RECORDS + (ticket))
#define USES (RECORDS + MOST_TICKETS + 1)
#include "memory.inc"

#define sender 0
#define receiver 1
#define SLOT(ticket) ((ticket - 1) % RECORDS)
#define MAY_DIE skip
#include "record.inc"

bool torn, lost, reused, answer;

inline send() {
  load_own(sender, HEAD, relaxed, sent);
  load(sender, TAIL, ORDER(acquire, TWIN_SEND_RELAXED), tail);
  if
  :: sent - tail >= RECORDS /* full */
  :: else ->
    CLAIM(reused, HAPPENED(sender, SLOT(sent + 1)));
    letters++;
    record_write(sender, SLOT(sent + 1), sent + 1, sent + 1);
    store(sender, HEAD, sent + 1, ORDER(release, TWIN_HEAD_RELAXED))
  fi
}

inline last_ticket(into) {
  load_own(sender, HEAD, relaxed, into)
}

inline poll(ticket) {
  load(sender, RESULT(SLOT(ticket)), ORDER(acquire, TWIN_POLL_RELAXED), result);
  CLAIM(answer, result != ticket || HAPPENED(sender, DONE(ticket)));
  result = 0
}

inline start() {
  load(receiver, HEAD, ORDER(acquire, SPARE_START), taken);
  store(receiver, TAIL, taken, ORDER(release, SPARE_FIRST_TAIL))
}

/* Sets `whole`: there is a letter. */
inline receive() {
  load(receiver, HEAD, ORDER(acquire, TWIN_RECEIVE_RELAXED), head);
  if
  :: head == taken
  :: head != taken && head - taken > RECORDS ->
    taken = head;
    store(receiver, TAIL, taken, ORDER(release, TWIN_SKIP_RELAXED))
  :: head != taken && head - taken <= RECORDS ->
    taken++;
#ifdef TWIN_TAIL_BEFORE_COPY
    store(receiver, TAIL, taken, ORDER(release, TWIN_TAIL_RELAXED));
#endif
    record_read(receiver, SLOT(taken), taken);
    CLAIM(lost, whole);
    CLAIM(torn, got[0] == taken && got[1] == taken);
    use(receiver, SLOT(taken));
#ifndef TWIN_TAIL_BEFORE_COPY
    store(receiver, TAIL, taken, ORDER(release, TWIN_TAIL_RELAXED))
#endif
  fi
}

inline reply(ticket) {
  store(receiver, RESULT(SLOT(ticket)), ticket, ORDER(release, TWIN_ANSWER_RELAXED))
}

active proctype Sender() {
  byte sent, tail, result, letters;
  bool jumped;

  do
  :: letters < LETTERS -> atomic { send(); sent = 0; tail = 0; forget_known(sender) }
  :: !jumped -> atomic { jumped = true; last_ticket(sent); store(sender, HEAD, sent + RECORDS + 1, relaxed); sent = 0 }
  :: NEWEST(HEAD) > 0 -> atomic { last_ticket(sent); poll(sent); sent = 0; forget_known(sender) }
  od
}

active proctype Receiver() {
  byte taken, head;

  atomic { start(); forget_known(receiver) };
  do
  :: atomic {
      receive();
      if
      :: whole -> use(receiver, DONE(taken)); reply(taken)
      :: else
      fi;
      d_step { head = 0; there = 0; got[0] = 0; got[1] = 0; whole = false };
      forget_known(receiver)
    }
  od
}
