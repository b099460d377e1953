"""C++ for operations that Warp lacks: a variant for the GPU and an equivalent for the processor (names: `dialect`)."""

# A word is 16 bytes: one load, through the read-only cache (a step never writes the words that it reads).
LOAD = """
#if defined(__CUDA_ARCH__)
    {vector} t = __ldg(reinterpret_cast<const {vector}*>(array.data + k)); return {type}({parts});
#else
    return array.data[k];
#endif
"""
STORE = """
#if defined(__CUDA_ARCH__)
    *reinterpret_cast<{vector}*>(array.data + k) = make_{vector}({parts});
#else
    array.data[k] = v;
#endif
"""
# For launches of several steps, where the next step writes these words. The kernel selects the array at run time, so
# the compiler must be told that it is in global memory.
LOAD_CHANGING = """
#if defined(__CUDA_ARCH__)
    __builtin_assume(__isGlobal(array.data + k));
    {vector} t = *reinterpret_cast<const {vector}*>(array.data + k); return {type}({parts});
#else
    return array.data[k];
#endif
"""
STORE_CHANGING = STORE.replace("    *re", "    __builtin_assume(__isGlobal(array.data + k));\n    *re")
# Without Warp's test for negative indices.
LOAD_PLAINLY = " return array.data[k]; "
# Quotient of non-negative numbers: unsigned division is cheaper.
QUOTIENT = " return (int)((unsigned)i / (unsigned)n); "
LOAD_INT = """
#if defined(__CUDA_ARCH__)
    return __ldg(array.data + k);
#else
    return array.data[k];
#endif
"""
# Four numbers in one or two instructions. The loads are volatile for the reason given at LOAD_NOW.
LOAD_FOUR_SINGLES = """
#if defined(__CUDA_ARCH__)
    float a, b, c, d;
    asm volatile("ld.volatile.global.v4.f32 {%0, %1, %2, %3}, [%4];"
        : "=f"(a), "=f"(b), "=f"(c), "=f"(d) : "l"(array.data + k));
    return wp::vec4f(a, b, c, d);
#else
    return array.data[k];
#endif
"""
STORE_FOUR_SINGLES = """
#if defined(__CUDA_ARCH__)
    *reinterpret_cast<float4*>(array.data + k) = make_float4(v[0], v[1], v[2], v[3]);
#else
    array.data[k] = v;
#endif
"""
LOAD_FOUR_DOUBLES = """
#if defined(__CUDA_ARCH__)
    double a, b, c, d;
    asm volatile("ld.volatile.global.v2.f64 {%0, %1}, [%2];" : "=d"(a), "=d"(b) : "l"(array.data + k));
    asm volatile("ld.volatile.global.v2.f64 {%0, %1}, [%2 + 16];" : "=d"(c), "=d"(d) : "l"(array.data + k));
    return wp::vec4d(a, b, c, d);
#else
    return array.data[k];
#endif
"""
STORE_FOUR_DOUBLES = """
#if defined(__CUDA_ARCH__)
    double2* to = reinterpret_cast<double2*>(array.data + k);
    to[0] = make_double2(v[0], v[1]); to[1] = make_double2(v[2], v[3]);
#else
    array.data[k] = v;
#endif
"""
# A load that the compiler does not move: it would delay it to the first use, and then wait for memory. A store to the
# same place depends on the loaded value, so no store can overtake the load.
LOAD_NOW = """
#if defined(__CUDA_ARCH__)
    int t; asm volatile("ld.volatile.global.s32 %0, [%1];" : "=r"(t) : "l"(array.data + k)); return t;
#else
    return array.data[k];
#endif
"""
# With fast math, compilers flush subnormal singles to zero and test for them in every conversion; these do not.
ROUNDED = """
#if defined(__CUDA_ARCH__)
    float s; asm("cvt.rn.f32.f64 %0, %1;" : "=f"(s) : "d"(v)); return s;
#else
    return (float)v;
#endif
"""
WIDENED = """
#if defined(__CUDA_ARCH__)
    double d; asm("cvt.f64.f32 %0, %1;" : "=d"(d) : "f"(v)); return d;
#else
    return (double)v;
#endif
"""
IDENTITY = " return v; "
# Sum over the `lanes` neighbouring threads that share a grain; `dialect` derives `or` and maximum from it.
ADD_LANES = """
#if defined(__CUDA_ARCH__)
    unsigned lane = threadIdx.x & 31u;
    unsigned mask = ((1u << lanes) - 1u) << (lane & ~(unsigned)(lanes - 1));
    for (int o = lanes >> 1; o > 0; o >>= 1) v += __shfl_xor_sync(mask, v, o);
#endif
    return v;
"""
# Lists that are not in a cache come from device memory, and loads wait for them. So each thread of a warp prefetches a
# line of 128 bytes for its 32 grains: of springs, and of neighbours from the third entry on, since the step has already
# loaded the first two. at: first entry of this thread's list; entries: number to prefetch, as far as 32 lines reach.
PREFETCH_LISTS = """
#if defined(__CUDA_ARCH__)
    const int l = threadIdx.x & 31;
    const int lines = sizeof(*springs.data) / 4;
    const int entry = l / (lines + 1), line = l % (lines + 1);
    const char* there = line < lines
        ? reinterpret_cast<const char*>(springs.data + (at - l) + entry * cap) + line * 128
        : reinterpret_cast<const char*>(neighbours.data + (at - l) + (entry + 2) * cap);
    if (entry < entries) asm volatile("prefetch.global.L2 [%0];" :: "l"(there));
#endif
"""
# Warp computes the thread's number in 64 bits, for launches of any shape. This is cheaper, and equal in one dimension.
THIS_THREAD = """
#if defined(__CUDA_ARCH__)
    return (int)(((blockIdx.z * gridDim.y + blockIdx.y) * gridDim.x + blockIdx.x) * blockDim.x + threadIdx.x);
#else
    return i;
#endif
"""
# Barrier of all blocks of a launch, which must all be resident: no thread continues before all have arrived, and then
# it sees their stores. The highest bit of the counter flips as the last block arrives, so it is never reset; it cannot
# flip before this block has arrived. Polling bypasses the first-level cache, which other blocks still use; the fence
# invalidates it once.
WAIT_FOR_ALL = """
#if defined(__CUDA_ARCH__)
    __syncthreads();
    if (threadIdx.x == 0) {
        const unsigned own = blockIdx.x == 0 ? 0x80000000u - (gridDim.x - 1u) : 1u;
        unsigned before, now, looks = 0;
        asm volatile("ld.relaxed.gpu.global.u32 %0, [%1];" : "=r"(before) : "l"(arrived.data) : "memory");
        asm volatile("red.release.gpu.global.add.u32 [%0], %1;" :: "l"(arrived.data), "r"(own) : "memory");
        do {
            asm volatile("ld.relaxed.gpu.global.u32 %0, [%1];" : "=r"(now) : "l"(arrived.data) : "memory");
            if (++looks == 1u << 28) __trap();  // minutes: blocks that have no room here never come
        } while (((before ^ now) >> 31) == 0u);
        asm volatile("fence.acq_rel.gpu;" ::: "memory");
    }
    __syncthreads();
#endif
"""
OTHER_OF_TWO = """
#if defined(__CUDA_ARCH__)
    return __shfl_xor_sync(3u << (threadIdx.x & 30u), v, 1);
#else
    return v;
#endif
"""
FIRST_BIT = """
#if defined(__CUDA_ARCH__)
    return __ffs((int)mask) - 1;
#else
    int k = 0; while (!((mask >> k) & 1u)) k++; return k;
#endif
"""
WITHOUT_FIRST = """
    for (int k = 0; k < n; k++) mask &= mask - 1u;
    return mask;
"""
JOINED = """
    union { float f[2]; double d; } u; u.f[0] = low; u.f[1] = high; return u.d;
"""
HALVED = """
    union { float f[2]; double d; } u; u.d = v; return high ? u.f[1] : u.f[0];
"""
