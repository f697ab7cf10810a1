/*
 * Holds a build of the control step against vectors from 60-digit arithmetic. Link it with the
 * controller, its parameter sets and pf_elementary.c:
 *
 *     cc -std=c99 -O2 -ffp-contract=off -fno-math-errno -DPF_VECTORS='"pendubot_vectors.h"' \
 *        -DPF_VECTORS_MAIN -I. -Igenerated/pendubot/c check_vectors.c pendubot*.c pf_elementary.c
 *
 * Without PF_VECTORS_MAIN it needs no library: call pf_vectors_check on the board and look at what
 * it leaves in pf_vectors_result.
 */
#include PF_VECTORS

#include <stdint.h>

struct {
    uint32_t checked, failed;    /* vectors */
    uint32_t vector, result;     /* where the worst was */
    double worst;                /* error as a share of its tolerance */
    uint64_t digest;             /* FNV-1a over the bits of every result: the same on every build */
} pf_vectors_result;
uint32_t pf_vectors_check(void);

uint32_t pf_vectors_check(void)
{
    const uint32_t count = (uint32_t)(sizeof pf_vectors / sizeof pf_vectors[0]);
    uint32_t i, k, byte;

    pf_vectors_result.digest = UINT64_C(0xcbf29ce484222325);
    pf_vectors_result.worst = 0.0;
    pf_vectors_result.checked = pf_vectors_result.failed = 0U;
    for (i = 0U; i < count; ++i) {
        const pf_vector_t *vector = &pf_vectors[i];
        PF_VECTOR_STATE_T state;
        PF_VECTOR_INPUT_T input;
        PF_VECTOR_OUTPUT_T output;
        union { double value; uint64_t bits; } result[PF_VECTOR_RESULTS];
        double results[PF_VECTOR_RESULTS];
        uint32_t good = (PF_VECTOR_INIT(&state, vector->params) == 0) ? 1U : 0U;

        pf_vector_give(vector, &state, &input);
        good &= ((int)PF_VECTOR_STEP(&state, vector->params, &input, &output) < 3) ? 1U : 0U;
        pf_vector_take(&state, &output, results);
        for (k = 0U; k < PF_VECTOR_RESULTS; ++k) {
            const double off = results[k] - vector->wanted[k];
            const double share = ((off < 0.0) ? -off : off) / vector->tolerance[k];

            result[k].value = results[k];
            for (byte = 0U; byte < 64U; byte += 8U) {
                pf_vectors_result.digest ^= (result[k].bits >> byte) & 0xffU;
                pf_vectors_result.digest *= UINT64_C(0x100000001b3);
            }
            if (!(share <= pf_vectors_result.worst)) {
                pf_vectors_result.worst = share;
                pf_vectors_result.vector = i;
                pf_vectors_result.result = k;
            }
            good &= (share <= 1.0) ? 1U : 0U; /* false for what is no number */
        }
        ++pf_vectors_result.checked;
        pf_vectors_result.failed += 1U - good;
    }
    return pf_vectors_result.failed;
}

#ifdef PF_VECTORS_MAIN
#include <stdio.h>

int main(void)
{
    const uint32_t failed = pf_vectors_check();

    printf("%u of %u vectors failed; worst %.3f of the tolerance, %s of vector %u; digest %08x%08x\n",
        (unsigned)failed, (unsigned)pf_vectors_result.checked, pf_vectors_result.worst,
        pf_vector_names[pf_vectors_result.result], (unsigned)pf_vectors_result.vector,
        (unsigned)(pf_vectors_result.digest >> 32), (unsigned)pf_vectors_result.digest);
    return (failed == 0U) ? 0 : 1;
}
#endif
