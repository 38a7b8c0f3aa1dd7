; Cups are carried between shelves and stacked: what the translator practises on. Nobody plans with it.
(define (domain practice)
  (:requirements :strips :typing :negative-preconditions :equality :action-costs)

  (:types
    arm place thing - object
    shelf - place
    cup - thing)

  (:predicates
    (bare ?x1 - thing)
    (busy ?x1 - arm)
    (distinct ?x1 ?x2)
    (held ?x1 - arm ?x2 - thing)
    (near ?x1 - arm ?x2 - thing)
    (upon ?x1 - thing ?x2))

  (:functions
    (total-cost) - number)

  (:action approach
    :parameters (?a - arm ?c - cup)
    :precondition (and
      (bare ?c)
      (not (busy ?a)))
    :effect (and
      (busy ?a)
      (near ?a ?c)
      (increase (total-cost) 1)))

  (:action give_up
    :parameters (?a - arm ?c - cup)
    :precondition (and
      (busy ?a)
      (near ?a ?c))
    :effect (and
      (not (busy ?a))
      (not (near ?a ?c))
      (increase (total-cost) 1)))

  (:action lift
    :parameters (?a - arm ?c - cup ?from - shelf)
    :precondition (and
      (bare ?c)
      (near ?a ?c)
      (upon ?c ?from))
    :effect (and
      (held ?a ?c)
      (not (bare ?c))
      (not (near ?a ?c))
      (not (upon ?c ?from))
      (increase (total-cost) 2)))

  (:action set_down
    :parameters (?a - arm ?c - cup ?to - shelf)
    :precondition (and
      (busy ?a)
      (held ?a ?c))
    :effect (and
      (bare ?c)
      (upon ?c ?to)
      (not (busy ?a))
      (not (held ?a ?c))
      (increase (total-cost) 2)))

  (:action stack
    :parameters (?a - arm ?c - cup ?to - cup)
    :precondition (and
      (bare ?to)
      (distinct ?c ?to)
      (held ?a ?c)
      (not (= ?c ?to)))
    :effect (and
      (bare ?c)
      (upon ?c ?to)
      (not (bare ?to))
      (not (busy ?a))
      (not (held ?a ?c))
      (increase (total-cost) 3)))

  (:action unstack
    :parameters (?a - arm ?c - cup ?from - cup ?to - cup)
    :precondition (and
      (bare ?c)
      (bare ?to)
      (distinct ?c ?to)
      (near ?a ?c)
      (upon ?c ?from)
      (not (= ?c ?to)))
    :effect (and
      (bare ?from)
      (upon ?c ?to)
      (not (bare ?to))
      (not (busy ?a))
      (not (near ?a ?c))
      (not (upon ?c ?from))
      (increase (total-cost) 4))))
