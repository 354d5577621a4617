;; Scores of language codes with one text, and the best with any of several.
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
        (br_if $row (local.tee $rows (i32.sub (local.get $rows) (i32.const 1))))))))
