; acted_on is "actedOn"
; cube is "Cube"
; graspable_1 is "Graspable"
; hand is "Hand"
; hand_move is "handMove"
; hand_open is "handOpen"
; in_hand is "inHand"
; in_touch is "inTouch"
; on_top is "onTop"
; surface is "Surface"
; table is "Table"
; wooden_cube is "WoodenCube"
(define (domain cube-stacking)
  (:requirements :strips :typing :negative-preconditions :action-costs)

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
    (in_touch ?x1 - graspable_1 ?x2)
    (on_top ?x1 - graspable_1 ?x2))

  (:functions
    (total-cost) - number)

  (:action idle_1
    ; activity "Idle", count 18
    :parameters (?hand - hand)
    :precondition (and
      (hand_move ?hand)
      (hand_open ?hand))
    :effect (and
      (not (hand_move ?hand))
      (increase (total-cost) 10)))

  (:action put_1
    ; activity "Put", count 18
    ; ?object_1 is "?object"
    :parameters (?hand - hand ?object_1 - graspable_1 ?from - surface ?to - graspable_1)
    :precondition (and
      (clear ?to)
      (in_hand ?hand ?object_1)
      (in_touch ?object_1 ?from)
      (in_touch ?object_1 ?hand)
      (on_top ?object_1 ?from)
      (not (hand_move ?hand))
      (not (hand_open ?hand))
      (not (in_hand ?hand ?to)))
    :effect (and
      (acted_on ?hand ?to)
      (hand_move ?hand)
      (in_touch ?object_1 ?to)
      (in_touch ?to ?object_1)
      (on_top ?object_1 ?to)
      (not (clear ?to))
      (not (in_touch ?object_1 ?from))
      (not (on_top ?object_1 ?from))
      (increase (total-cost) 10)))

  (:action reach_1
    ; activity "Reach", count 18
    ; ?object_1 is "?object"
    :parameters (?hand - hand ?object_1 - graspable_1)
    :precondition (and
      (clear ?object_1)
      (hand_open ?hand)
      (not (hand_move ?hand)))
    :effect (and
      (acted_on ?hand ?object_1)
      (graspable ?hand ?object_1)
      (hand_move ?hand)
      (in_touch ?object_1 ?hand)
      (increase (total-cost) 10)))

  (:action release_1
    ; activity "Release", count 17
    ; ?object_1 is "?object"
    :parameters (?hand - hand ?object_1 - graspable_1)
    :precondition (and
      (hand_move ?hand)
      (in_hand ?hand ?object_1)
      (in_touch ?object_1 ?hand)
      (not (hand_open ?hand)))
    :effect (and
      (clear ?object_1)
      (hand_open ?hand)
      (not (in_hand ?hand ?object_1))
      (not (in_touch ?object_1 ?hand))
      (increase (total-cost) 11)))

  (:action take_1
    ; activity "Take", count 18
    ; ?object_1 is "?object"
    :parameters (?hand - hand ?object_1 - graspable_1)
    :precondition (and
      (acted_on ?hand ?object_1)
      (clear ?object_1)
      (graspable ?hand ?object_1)
      (hand_move ?hand)
      (hand_open ?hand)
      (in_touch ?object_1 ?hand))
    :effect (and
      (in_hand ?hand ?object_1)
      (not (acted_on ?hand ?object_1))
      (not (clear ?object_1))
      (not (graspable ?hand ?object_1))
      (not (hand_move ?hand))
      (not (hand_open ?hand))
      (increase (total-cost) 10))))
