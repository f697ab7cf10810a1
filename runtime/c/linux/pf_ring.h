/*
 * A ring of records between one writer and one reader that never wait for each other: the writer is
 * the periodic loop, the reader puts them on a disk. Head and tail only grow; each is written by
 * one side alone.
 */
#ifndef PF_RING_H
#define PF_RING_H

#include "pf_flight.h"

#define PF_RING_SIZE 4096U /* records; a power of two, so that the counters may wrap */

typedef struct {
    pf_record_t records[PF_RING_SIZE];
    uint32_t head __attribute__((aligned(64))); /* written next; the two lie in lines of their own */
    uint32_t tail __attribute__((aligned(64))); /* read next */
    uint32_t dropped __attribute__((aligned(64))); /* records that found no room */
} pf_ring_t;

/* Returns 1, or 0 where there was no room; nothing is counted then. */
static inline int pf_ring_put(pf_ring_t *ring, const pf_record_t *record)
{
    const uint32_t head = ring->head;

    if (head - __atomic_load_n(&ring->tail, __ATOMIC_ACQUIRE) >= PF_RING_SIZE) {
        return 0;
    }
    ring->records[head % PF_RING_SIZE] = *record;
    __atomic_store_n(&ring->head, head + 1U, __ATOMIC_RELEASE);
    return 1;
}

/* Returns 1, or 0 where there is none. */
static inline int pf_ring_take(pf_ring_t *ring, pf_record_t *record)
{
    const uint32_t tail = ring->tail;

    if (tail == __atomic_load_n(&ring->head, __ATOMIC_ACQUIRE)) {
        return 0;
    }
    *record = ring->records[tail % PF_RING_SIZE];
    __atomic_store_n(&ring->tail, tail + 1U, __ATOMIC_RELEASE);
    return 1;
}

#endif
