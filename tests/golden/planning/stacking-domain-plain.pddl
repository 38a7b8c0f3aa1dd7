; acted_on is "actedOn"
; cube is "Cube"
; graspable_1 is "Graspable"
; hand is "Hand"
; hand_move is "handMove"
; hand_open is "handOpen"
; idle_1 is "Idle_1"
; in_hand is "inHand"
; on_top is "onTop"
; put_1 is "Put_1"
; put_2 is "Put_2"
; put_3 is "Put_3"
; reach_1 is "Reach_1"
; release_1 is "Release_1"
; surface is "Surface"
; table is "Table"
; take_1 is "Take_1"
; wooden_cube is "WoodenCube"
(define (domain cube-stacking)
  (:requirements :strips :typing :negative-preconditions :equality)

  (:types
    graspable_1 hand surface - object
    cube - graspable_1
    wooden_cube - cube
    table - surface)

  (:predicates
    (acted_on ?x1 - hand ?x2)
    (clear ?x1 - graspable_1)
    (graspable ?x1 - hand ?x2 - graspable_1)
    (hand_move ?x1 - hand)
    (hand_open ?x1 - hand)
    (in_hand ?x1 - hand ?x2 - graspable_1)
    (on_top ?x1 - graspable_1 ?x2))

  (:action idle_1
    ; activity "Idle", count 24
    :parameters (?h - hand)
    :precondition (and
      (hand_move ?h)
      (hand_open ?h))
    :effect (and
      (not (hand_move ?h))))

  (:action put_1
    ; activity "Put", count 15
    :parameters (?h - hand ?c - cube ?from - table ?to - cube)
    :precondition (and
      (clear ?to)
      (in_hand ?h ?c)
      (on_top ?c ?from)
      (not (= ?c ?to))
      (not (hand_move ?h))
      (not (hand_open ?h)))
    :effect (and
      (hand_move ?h)
      (on_top ?c ?to)
      (not (clear ?to))
      (not (on_top ?c ?from))))

  (:action put_2
    ; activity "Put", count 6
    :parameters (?h - hand ?c - cube ?from - cube ?to - table)
    :precondition (and
      (in_hand ?h ?c)
      (on_top ?c ?from)
      (not (hand_move ?h))
      (not (hand_open ?h)))
    :effect (and
      (clear ?from)
      (hand_move ?h)
      (on_top ?c ?to)
      (not (on_top ?c ?from))))

  (:action put_3
    ; activity "Put", count 3
    :parameters (?h - hand ?c - cube ?from - cube ?to - cube)
    :precondition (and
      (clear ?to)
      (in_hand ?h ?c)
      (on_top ?c ?from)
      (not (= ?c ?to))
      (not (hand_move ?h))
      (not (hand_open ?h)))
    :effect (and
      (clear ?from)
      (hand_move ?h)
      (on_top ?c ?to)
      (not (clear ?to))
      (not (on_top ?c ?from))))

  (:action reach_1
    ; activity "Reach", count 24
    :parameters (?h - hand ?c - cube)
    :precondition (and
      (clear ?c)
      (hand_open ?h)
      (not (hand_move ?h)))
    :effect (and
      (acted_on ?h ?c)
      (graspable ?h ?c)
      (hand_move ?h)))

  (:action release_1
    ; activity "Release", count 24
    :parameters (?h - hand ?c - cube)
    :precondition (and
      (hand_move ?h)
      (in_hand ?h ?c)
      (not (hand_open ?h)))
    :effect (and
      (clear ?c)
      (hand_open ?h)
      (not (acted_on ?h ?c))
      (not (in_hand ?h ?c))))

  (:action take_1
    ; activity "Take", count 24
    :parameters (?h - hand ?c - cube)
    :precondition (and
      (clear ?c)
      (graspable ?h ?c)
      (hand_move ?h)
      (hand_open ?h))
    :effect (and
      (in_hand ?h ?c)
      (not (clear ?c))
      (not (graspable ?h ?c))
      (not (hand_move ?h))
      (not (hand_open ?h)))))
