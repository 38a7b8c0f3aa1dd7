(define (problem practice-1)
  (:domain practice)

  (:objects
    arm_1 - arm
    cup_1 cup_2 cup_3 - cup
    low - shelf)

  (:init
    (= (total-cost) 0)
    (bare cup_1)
    (bare cup_3)
    (distinct cup_1 cup_2)
    (distinct cup_1 cup_3)
    (distinct cup_2 cup_1)
    (distinct cup_2 cup_3)
    (distinct cup_3 cup_1)
    (distinct cup_3 cup_2)
    (upon cup_1 cup_2)
    (upon cup_2 low)
    (upon cup_3 low))

  (:goal (and
    (upon cup_2 cup_3)
    (upon cup_3 cup_1)))

  (:metric minimize (total-cost)))
