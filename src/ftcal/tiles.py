"""Samples to scratch memory and back, tile by tile, as LLVM IR.

A tile stays in the cache. Signals lie in memory sample by sample, the sections of a program want
them signal by signal: blocks of neighbouring signals are read as short vectors and transposed in
registers. While a section computes, it asks the memory for the lines of the next tile. Samples
after the last are copies of the last, and are not written back.
"""

from __future__ import annotations

TILE = 128
"""Samples of a tile."""
ROW = TILE + 8
"""Numbers from one row of the scratch to the next; a multiple of 4 kB would make rows collide."""
BLOCK_HEAD = 3
"""Words of a block before its rows: address, stride, count of signals."""


def transpose(width: int) -> str:
    """Return code that reads a block of up to `width` signals and writes it to rows of scratch.

    The recursive exchange of off-diagonal halves: log2(width) rounds of shuffles.
    """
    vector = f"<{width} x double>"
    read = f"call {vector} @llvm.masked.load.v{width}f64.p0(ptr %from{{k}}, i32 8,"
    lines = [
        f"  %skip{k} = mul i64 %r{k}, %stride\n"
        f"  %from{k} = getelementptr i8, ptr %source, i64 %skip{k}\n"
        f"  %s1_{k} = {read.format(k=k)} <{width} x i1> %mask, {vector} zeroinitializer)"
        for k in range(width)
    ]
    step = 1
    while step < width:
        for k in range(width):
            first, second = k & ~step, k | step
            # lanes of the second vector are numbered from `width`
            if k == first:
                lanes = [width + n - step if n & step else n for n in range(width)]
            else:
                lanes = [width + n if n & step else n + step for n in range(width)]
            lines.append(
                f"  %s{2 * step}_{k} = shufflevector {vector} %s{step}_{first}, {vector}"
                f" %s{step}_{second}, <{width} x i32> <{', '.join(f'i32 {n}' for n in lanes)}>"
            )
        step *= 2
    lines += [
        f"  %row_at{k} = getelementptr i64, ptr %block, i64 {BLOCK_HEAD + k}\n"
        f"  %row{k} = load i64, ptr %row_at{k}\n"
        f"  %to{k} = getelementptr double, ptr %band_at, i64 %row{k}\n"
        f"  store {vector} %s{width}_{k}, ptr %to{k}, align {8 * width}"
        for k in range(width)
    ]
    return "\n".join(lines)


FETCH = """\
  call void @llvm.prefetch.p0(ptr %q{c}, i32 0, i32 3, i32 1)
  %q{d} = getelementptr i8, ptr %q{c}, i64 %stride"""

PUT = """\
  %in{c} = getelementptr double, ptr %in, i64 {row}
  %w{c} = load double, ptr %in{c}
  %out{c} = getelementptr double, ptr %out, i64 {c}
  store double %w{c}, ptr %out{c}, align 8"""

SECTION = """
define internal void @section{section}(ptr noalias %scratch, i64 %m, ptr noalias %ahead,
                                i64 %ahead_start) noinline nounwind {{
entry:
  %bounds = getelementptr i64, ptr %ahead, i64 {number}
  %e_first = load i64, ptr %bounds
  %bounds_next = getelementptr i64, ptr %bounds, i64 1
  %e_last = load i64, ptr %bounds_next
  br label %loop
loop:
  %i = phi i64 [ 0, %entry ], [ %next, %work ]
  %at = getelementptr double, ptr %scratch, i64 %i
  %sample = add i64 %ahead_start, %i
  %any = icmp ult i64 %e_first, %e_last
  br i1 %any, label %fetch, label %work
fetch:
  %e = phi i64 [ %e_first, %loop ], [ %e_next, %fetch ]
  %entry_at = getelementptr i64, ptr %ahead, i64 %e
  %line = load ptr, ptr %entry_at
  %stride_at = getelementptr i64, ptr %entry_at, i64 1
  %stride = load i64, ptr %stride_at
  %skip = mul i64 %stride, %sample
  %q0 = getelementptr i8, ptr %line, i64 %skip
{fetches}
  %e_next = add i64 %e, 2
  %e_more = icmp ult i64 %e_next, %e_last
  br i1 %e_more, label %fetch, label %work
work:
{body}
  %next = add i64 %i, {width}
  %more = icmp ult i64 %next, %m
  br i1 %more, label %loop, label %done
done:
  ret void
}}
"""

DRIVER = """
declare <{width} x double> @llvm.masked.load.v{width}f64.p0(ptr, i32, <{width} x i1>,
                                                            <{width} x double>)
define void @wrenches(ptr noalias %blocks, i64 %block_end, ptr noalias %targets,
                      ptr noalias %scratch, ptr noalias %ahead, i64 %n) nounwind {{
entry:
  %any = icmp ugt i64 %n, 0
  br i1 %any, label %tile, label %done
tile:
  %start = phi i64 [ 0, %entry ], [ %stop, %tile_end ]
  %rest = sub i64 %n, %start
  %stop = add i64 %start, {tile}
  %final = sub i64 %n, 1
  %m = call i64 @llvm.umin.i64(i64 %rest, i64 {tile})
  br label %band
band:
  %b = phi i64 [ 0, %tile ], [ %b_next, %band_end ]
  %b_next = add i64 %b, {width}
  %b_from = add i64 %start, %b
{clamps}
  %no_signal = icmp eq i64 %block_end, 0
  br i1 %no_signal, label %band_end, label %column
column:
  %k = phi i64 [ 0, %band ], [ %k_next, %column ]
  %block = getelementptr i64, ptr %blocks, i64 %k
  %source = load ptr, ptr %block
  %stride_at = getelementptr i64, ptr %block, i64 1
  %stride = load i64, ptr %stride_at
  %lanes_at = getelementptr i64, ptr %block, i64 2
  %lanes = load i64, ptr %lanes_at
  %lanes_one = insertelement <{width} x i64> poison, i64 %lanes, i64 0
  %lanes_all = shufflevector <{width} x i64> %lanes_one, <{width} x i64> poison,
                             <{width} x i32> zeroinitializer
  %mask = icmp ult <{width} x i64> {ramp}, %lanes_all
  %band_at = getelementptr double, ptr %scratch, i64 %b
{transpose}
  %k_next = add i64 %k, {block_words}
  %k_more = icmp ult i64 %k_next, %block_end
  br i1 %k_more, label %column, label %band_end
band_end:
  %b_more = icmp ult i64 %b_next, %m
  br i1 %b_more, label %band, label %work
work:
{calls}
  br label %sensor
sensor:
  %s = phi i64 [ 0, %work ], [ %s_next, %sensor_end ]
  %s_more = icmp ult i64 %s, {sensors}
  br i1 %s_more, label %wrench, label %tile_end
wrench:
  %target_at = getelementptr ptr, ptr %targets, i64 %s
  %target = load ptr, ptr %target_at
  %six = mul i64 %s, {row}
  %six_rows = mul i64 %six, 6
  %result_row = add i64 %six_rows, {results}
  %result = getelementptr double, ptr %scratch, i64 %result_row
  br label %put
put:
  %r = phi i64 [ 0, %wrench ], [ %r_next, %put ]
  %sample_number = add i64 %start, %r
  %out_number = mul i64 %sample_number, 6
  %out = getelementptr double, ptr %target, i64 %out_number
  %in = getelementptr double, ptr %result, i64 %r
{puts}
  %r_next = add i64 %r, 1
  %r_more = icmp ult i64 %r_next, %m
  br i1 %r_more, label %put, label %sensor_end
sensor_end:
  %s_next = add i64 %s, 1
  br label %sensor
tile_end:
  %more = icmp ult i64 %stop, %n
  br i1 %more, label %tile, label %done
done:
  ret void
}}
declare i64 @llvm.umin.i64(i64, i64)
declare void @llvm.prefetch.p0(ptr, i32, i32, i32)
"""
