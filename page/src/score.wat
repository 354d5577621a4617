;; Scores of language codes with one text, the best with any of several, and where scores lie in their range.
;;
;; Codes are bytes, rows of 8 * groups of them; weights are 16-bit, in the same order. 1.5 million rows of 24 take
;; JavaScript more than a tenth of a second for one text, which is what a query may take altogether.
(module
  (import "page" "memory" (memory 1))
  ;; out[row] = offset + factor * (codes . weights)
  (func (export "score")
    (param $codes i32) (param $rows i32) (param $groups i32) (param $weights i32)
    (param $offset f32) (param $factor f32) (param $out i32)
    (local $group i32) (local $at i32) (local $sum v128) (local $value f32)
    (block $done
      (br_if $done (i32.eqz (local.get $rows)))
      (loop $row
        (local.set $sum (v128.const i32x4 0 0 0 0))
        (local.set $group (local.get $groups))
        (local.set $at (local.get $weights))
        (loop $eight
          (local.set $sum
            (i32x4.add (local.get $sum)
              (i32x4.dot_i16x8_s (v128.load8x8_s (local.get $codes)) (v128.load (local.get $at)))))
          (local.set $codes (i32.add (local.get $codes) (i32.const 8)))
          (local.set $at (i32.add (local.get $at) (i32.const 16)))
          (br_if $eight (local.tee $group (i32.sub (local.get $group) (i32.const 1)))))
        (local.set $sum
          (i32x4.add (local.get $sum)
            (i8x16.shuffle 8 9 10 11 12 13 14 15 0 1 2 3 4 5 6 7 (local.get $sum) (local.get $sum))))
        (local.set $value
          (f32.add (local.get $offset)
            (f32.mul (local.get $factor)
              (f32.convert_i32_s
                (i32.add (i32x4.extract_lane 0 (local.get $sum)) (i32x4.extract_lane 1 (local.get $sum)))))))
        (f32.store (local.get $out) (local.get $value))
        (local.set $out (i32.add (local.get $out) (i32.const 4)))
        (br_if $row (local.tee $rows (i32.sub (local.get $rows) (i32.const 1)))))))

  ;; out[row] = factor * the largest of (offset + codes . weights) over the texts, whole numbers but for the factor.
  ;; Texts come in fours: the weights of each group of eight for the first, second, third and fourth of them, and so on;
  ;; before the weights of each four stand their offsets.
  (func (export "best")
    (param $codes i32) (param $rows i32) (param $groups i32) (param $weights i32) (param $fours i32)
    (param $factor f32) (param $out i32)
    (local $four i32) (local $group i32) (local $at i32) (local $code i32) (local $eight v128)
    (local $a v128) (local $b v128) (local $c v128) (local $d v128) (local $offsets v128) (local $most v128)
    (block $done
      (br_if $done (i32.eqz (local.get $rows)))
      (loop $row
        (local.set $most (v128.const i32x4 0x80000000 0x80000000 0x80000000 0x80000000))
        (local.set $four (local.get $fours))
        (local.set $at (local.get $weights))
        (loop $texts
          (local.set $offsets (v128.load (local.get $at)))
          (local.set $at (i32.add (local.get $at) (i32.const 16)))
          (local.set $a (v128.const i32x4 0 0 0 0))
          (local.set $b (v128.const i32x4 0 0 0 0))
          (local.set $c (v128.const i32x4 0 0 0 0))
          (local.set $d (v128.const i32x4 0 0 0 0))
          (local.set $code (local.get $codes))
          (local.set $group (local.get $groups))
          (loop $eights
            (local.set $eight (v128.load8x8_s (local.get $code)))
            (local.set $a (i32x4.add (local.get $a) (i32x4.dot_i16x8_s (local.get $eight) (v128.load (local.get $at)))))
            (local.set $b (i32x4.add (local.get $b) (i32x4.dot_i16x8_s (local.get $eight) (v128.load offset=16 (local.get $at)))))
            (local.set $c (i32x4.add (local.get $c) (i32x4.dot_i16x8_s (local.get $eight) (v128.load offset=32 (local.get $at)))))
            (local.set $d (i32x4.add (local.get $d) (i32x4.dot_i16x8_s (local.get $eight) (v128.load offset=48 (local.get $at)))))
            (local.set $at (i32.add (local.get $at) (i32.const 64)))
            (local.set $code (i32.add (local.get $code) (i32.const 8)))
            (br_if $eights (local.tee $group (i32.sub (local.get $group) (i32.const 1)))))
          ;; Four sums of four lanes become the four lanes of one.
          (local.set $a
            (i32x4.add
              (i8x16.shuffle 0 1 2 3 16 17 18 19 4 5 6 7 20 21 22 23 (local.get $a) (local.get $b))
              (i8x16.shuffle 8 9 10 11 24 25 26 27 12 13 14 15 28 29 30 31 (local.get $a) (local.get $b))))
          (local.set $c
            (i32x4.add
              (i8x16.shuffle 0 1 2 3 16 17 18 19 4 5 6 7 20 21 22 23 (local.get $c) (local.get $d))
              (i8x16.shuffle 8 9 10 11 24 25 26 27 12 13 14 15 28 29 30 31 (local.get $c) (local.get $d))))
          (local.set $most
            (i32x4.max_s (local.get $most)
              (i32x4.add (local.get $offsets)
                (i32x4.add
                  (i8x16.shuffle 0 1 2 3 4 5 6 7 16 17 18 19 20 21 22 23 (local.get $a) (local.get $c))
                  (i8x16.shuffle 8 9 10 11 12 13 14 15 24 25 26 27 28 29 30 31 (local.get $a) (local.get $c))))))
          (br_if $texts (local.tee $four (i32.sub (local.get $four) (i32.const 1)))))
        (local.set $most
          (i32x4.max_s (local.get $most)
            (i8x16.shuffle 8 9 10 11 12 13 14 15 0 1 2 3 4 5 6 7 (local.get $most) (local.get $most))))
        (local.set $most
          (i32x4.max_s (local.get $most)
            (i8x16.shuffle 4 5 6 7 0 1 2 3 12 13 14 15 8 9 10 11 (local.get $most) (local.get $most))))
        (f32.store (local.get $out)
          (f32.mul (local.get $factor) (f32.convert_i32_s (i32x4.extract_lane 0 (local.get $most)))))
        (local.set $out (i32.add (local.get $out) (i32.const 4)))
        (local.set $codes (i32.add (local.get $codes) (i32.shl (local.get $groups) (i32.const 3))))
        (br_if $row (local.tee $rows (i32.sub (local.get $rows) (i32.const 1)))))))

  ;; The lowest and the highest of some scores, at out.
  (func (export "range") (param $scores i32) (param $rows i32) (param $out i32)
    (local $low v128) (local $high v128) (local $four v128) (local $least f32) (local $most f32) (local $value f32)
    (local.set $low (v128.const f32x4 inf inf inf inf))
    (local.set $high (v128.const f32x4 -inf -inf -inf -inf))
    (block $done
      (loop $fours
        (br_if $done (i32.lt_u (local.get $rows) (i32.const 4)))
        (local.set $four (v128.load (local.get $scores)))
        (local.set $low (f32x4.pmin (local.get $low) (local.get $four)))
        (local.set $high (f32x4.pmax (local.get $high) (local.get $four)))
        (local.set $scores (i32.add (local.get $scores) (i32.const 16)))
        (local.set $rows (i32.sub (local.get $rows) (i32.const 4)))
        (br $fours)))
    (local.set $least
      (f32.min
        (f32.min (f32x4.extract_lane 0 (local.get $low)) (f32x4.extract_lane 1 (local.get $low)))
        (f32.min (f32x4.extract_lane 2 (local.get $low)) (f32x4.extract_lane 3 (local.get $low)))))
    (local.set $most
      (f32.max
        (f32.max (f32x4.extract_lane 0 (local.get $high)) (f32x4.extract_lane 1 (local.get $high)))
        (f32.max (f32x4.extract_lane 2 (local.get $high)) (f32x4.extract_lane 3 (local.get $high)))))
    (block $end
      (loop $ones
        (br_if $end (i32.eqz (local.get $rows)))
        (local.set $value (f32.load (local.get $scores)))
        (local.set $least (f32.min (local.get $least) (local.get $value)))
        (local.set $most (f32.max (local.get $most) (local.get $value)))
        (local.set $scores (i32.add (local.get $scores) (i32.const 4)))
        (local.set $rows (i32.sub (local.get $rows) (i32.const 1)))
        (br $ones)))
    (f32.store (local.get $out) (local.get $least))
    (f32.store offset=4 (local.get $out) (local.get $most)))

  ;; heat[row] = (scores - low) * scale as a byte; wins[row] = 1 where the score is the best less slack, or more.
  ;; Rows come in fours; what is written behind the last is nobody's.
  (func (export "grade")
    (param $scores i32) (param $best i32) (param $rows i32) (param $low f32) (param $scale f32) (param $slack f32)
    (param $heat i32) (param $wins i32)
    (local $four v128)
    (block $done
      (loop $fours
        (br_if $done (i32.le_s (local.get $rows) (i32.const 0)))
        (local.set $four (v128.load (local.get $scores)))
        (i32.store (local.get $heat)
          (i32x4.extract_lane 0
            (i8x16.shuffle 0 4 8 12 0 4 8 12 0 4 8 12 0 4 8 12
              (local.tee $four
                (i32x4.trunc_sat_f32x4_u
                  (f32x4.mul
                    (f32x4.sub (local.get $four) (f32x4.splat (local.get $low)))
                    (f32x4.splat (local.get $scale)))))
              (local.get $four))))
        (local.set $four
          (v128.and (v128.const i32x4 1 1 1 1)
            (f32x4.ge (v128.load (local.get $scores))
              (f32x4.sub (v128.load (local.get $best)) (f32x4.splat (local.get $slack))))))
        (i32.store (local.get $wins)
          (i32x4.extract_lane 0
            (i8x16.shuffle 0 4 8 12 0 4 8 12 0 4 8 12 0 4 8 12 (local.get $four) (local.get $four))))
        (local.set $scores (i32.add (local.get $scores) (i32.const 16)))
        (local.set $best (i32.add (local.get $best) (i32.const 16)))
        (local.set $heat (i32.add (local.get $heat) (i32.const 4)))
        (local.set $wins (i32.add (local.get $wins) (i32.const 4)))
        (local.set $rows (i32.sub (local.get $rows) (i32.const 4)))
        (br $fours)))))
