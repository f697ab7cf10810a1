/* What the modules of the runtime take for granted of arithmetic; the generated code brings the same. */
#ifndef PF_ARITHMETIC_H
#define PF_ARITHMETIC_H

/*
 * What the bits depend on: IEEE 754 arithmetic in double, every operation rounded once and to
 * nearest, none regrouped, contracted, or left out because its operands might be no numbers.
 *
 * A compiler that says that it does otherwise is refused here. Not every one says it:
 * pf_arithmetic_holds finds it out, and the init that calls it returns a status of its own. It
 * speaks for the flags of the file that it is compiled in; give all files the same.
 */
#include <stdint.h>

#if defined(__FAST_MATH__) || defined(__ASSOCIATIVE_MATH__) || defined(__RECIPROCAL_MATH__) || \
    defined(__NO_SIGNED_ZEROS__)
#error "results would differ: compile without -ffast-math and -funsafe-math-optimizations"
#endif
#if defined(__FINITE_MATH_ONLY__) && (__FINITE_MATH_ONLY__ != 0)
#error "what is no number would pass for one: compile without -ffinite-math-only"
#endif
#if defined(__FLT_EVAL_METHOD__) && (__FLT_EVAL_METHOD__ != 0) && (__FLT_EVAL_METHOD__ != 16)
#error "results are kept in another precision: for 32-bit x86 compile with -msse2 -mfpmath=sse"
#endif
#if defined(__GCC_IEC_559) && (__GCC_IEC_559 == 0) && !defined(__SOFTFP__) && !defined(_SOFT_FLOAT)
#error "gcc says that this is not the arithmetic of IEEE 754: compile with -ffp-contract=off"
#endif

/* A number and its bits. */
typedef union {
    double value;
    uint64_t bits;
} pf_arithmetic_t;

/* 0 where `value` has these bits. */
static inline uint64_t pf_arithmetic_differs(double value, uint64_t bits)
{
    pf_arithmetic_t seen;

    seen.value = value;
    return seen.bits ^ bits;
}

/* Read as if it were volatile: what a compiler works out beforehand proves nothing of the processor. */
static inline double pf_arithmetic_operand(const volatile uint64_t *bits)
{
    pf_arithmetic_t seen;

    seen.bits = *bits;
    return seen.value;
}

/* Returns 1 where the fused multiply-add rounds once, the product not by itself, else 0. */
static inline int pf_arithmetic_fuses(void)
{
    static const uint64_t table[] = {UINT64_C(0x3ff0000002000000), UINT64_C(0x3ff0000004000000)};
    const uint64_t exact = UINT64_C(0x3c90000000000000); /* (1 + 2^-27)^2 - (1 + 2^-26) = 2^-54 */
    const double factor = pf_arithmetic_operand(&table[0]);
    const double sum = __builtin_fma(factor, factor, -pf_arithmetic_operand(&table[1]));

    return (pf_arithmetic_differs(sum, exact) == 0U) ? 1 : 0;
}

/* Returns 1 where a few operations give the bits that IEEE 754 demands of them, else 0. */
static inline int pf_arithmetic_holds(void)
{
    static const uint64_t table[] = {
        UINT64_C(0x3ff0000000000000), /* 1 */
        UINT64_C(0x3ff0000000000001), /* 1 + 2^-52, the number after it */
        UINT64_C(0x3ca0000000000000), /* 2^-53, half of that last place */
        UINT64_C(0x3ff0000002000000), /* 1 + 2^-27 */
        UINT64_C(0x3ff0000004000000), /* 1 + 2^-26: its square without 2^-54 */
        UINT64_C(0x4048800000000000), /* 49, and 49 (1/49) is not 1 */
        UINT64_C(0), /* 0 */
        UINT64_C(0x0010000000000000), /* 2^-1022, the least normal number */
        UINT64_C(0x0000000000000001), /* 2^-1074, the least number */
        UINT64_C(0x7ff0000000000000), /* infinity */
        UINT64_C(0x7ff8000000000000) /* no number */
    };
    const double one = pf_arithmetic_operand(&table[0]);
    const double next = pf_arithmetic_operand(&table[1]);
    const double half = pf_arithmetic_operand(&table[2]);
    const double factor = pf_arithmetic_operand(&table[3]);
    const double again = pf_arithmetic_operand(&table[3]); /* a product for each sum */
    const double product = pf_arithmetic_operand(&table[4]);
    const double divisor = pf_arithmetic_operand(&table[5]);
    const double minus_zero = -pf_arithmetic_operand(&table[6]);
    const double normal = pf_arithmetic_operand(&table[7]);
    const double least = pf_arithmetic_operand(&table[8]);
    const double infinite = pf_arithmetic_operand(&table[9]);
    const double none = pf_arithmetic_operand(&table[10]);
    const uint64_t unit = UINT64_C(0x3ff0000000000000);
    uint64_t wrong = 0U;

    /* Rounding to nearest, of two that are as near to the even one. */
    wrong |= pf_arithmetic_differs(one + half, unit);
    wrong |= pf_arithmetic_differs(next + half, UINT64_C(0x3ff0000000000002));
    wrong |= pf_arithmetic_differs(-(-one - half), unit);
    /* No regrouping, and nothing kept in more digits. */
    wrong |= pf_arithmetic_differs((one + half) - one, UINT64_C(0));
    /* A product and a sum are rounded each. */
    wrong |= pf_arithmetic_differs(factor * factor - product, UINT64_C(0));
    wrong |= pf_arithmetic_differs(product - factor * again, UINT64_C(0));
    /* Quotients, not products with an inverse, for which it takes several, or a constant. */
    wrong |= pf_arithmetic_differs(divisor / divisor, unit);
    wrong |= pf_arithmetic_differs((divisor + divisor) / divisor, UINT64_C(0x4000000000000000));
    wrong |= pf_arithmetic_differs((divisor + divisor + divisor) / divisor,
        UINT64_C(0x4008000000000000));
    wrong |= pf_arithmetic_differs(divisor / 49.0, unit);
    /* Signs of zeros, and numbers that are subnormal. */
    wrong |= pf_arithmetic_differs(minus_zero + 0.0, UINT64_C(0));
    wrong |= pf_arithmetic_differs(normal * 0.5, UINT64_C(0x0008000000000000));
    wrong |= pf_arithmetic_differs(least * 4503599627370496.0, UINT64_C(0x0010000000000000));
    /* Every comparison with what is no number fails, and 0 times what is infinite is none. */
    if (none < one) {
        wrong = 1U;
    }
    if (none >= one) {
        wrong = 1U;
    }
    if (!(infinite > one) || (infinite <= 1.7976931348623157e+308)) {
        wrong = 1U;
    }
    if (0.0 * infinite < 1.0) {
        wrong = 1U;
    }
    return (wrong == 0U) ? 1 : 0;
}

#endif
