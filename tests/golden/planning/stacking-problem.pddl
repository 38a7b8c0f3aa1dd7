; hand is "Hand"
; hand_open is "handOpen"
; in_hand is "inHand"
; left_hand is "Left_hand"
; on_top is "onTop"
; right_hand is "Right_hand"
; table is "Table"
; table_1 is "table"
; two_towers_after_one is "two towers, after one"
; wooden_cube is "WoodenCube"
(define (problem two_towers_after_one)
  (:domain cube-stacking)

  (:objects
    left_hand right_hand - hand
    table_1 - table
    cube_blue cube_green cube_red cube_yellow - wooden_cube)

  (:init
    (= (total-cost) 0)
    (clear cube_blue)
    (clear cube_yellow)
    (hand_open left_hand)
    (hand_open right_hand)
    (on_top cube_blue cube_red)
    (on_top cube_green table_1)
    (on_top cube_red cube_green)
    (on_top cube_yellow table_1))

  (:goal (and
    (on_top cube_green cube_yellow)
    (on_top cube_red cube_blue)
    (not (in_hand right_hand cube_red))))

  (:metric minimize (total-cost)))
