// SPDX-License-Identifier: Apache-2.0
/// @file The contents of a captured frame: nodes by type, bytes copied, resources of its kernels.
#pragma once

#if defined(__CUDACC__)

#include <cuda_runtime.h>
#include <cxxabi.h>

#include <algorithm>
#include <cstddef>
#include <cstdlib>
#include <map>
#include <string>
#include <vector>

#include "bench/names.hpp"
#include "bench/runner.hpp"
#include "ft/core/execution.hpp"

namespace bench {
inline namespace FT_ABI {

/// A graph captured from `queue(exec)`, for inspection only.
class captured {
public:
  template <typename Queue>
  explicit captured(Queue const& queue) {
    ft::stream const capturing;
    ft::throw_on_error(cudaStreamBeginCapture(capturing.get(), cudaStreamCaptureModeThreadLocal),
                       "cudaStreamBeginCapture");
    queue(ft::cuda_exec(capturing.get()));
    ft::throw_on_error(cudaStreamEndCapture(capturing.get(), &graph_), "cudaStreamEndCapture");
    std::size_t count = 0;
    ft::throw_on_error(cudaGraphGetNodes(graph_, nullptr, &count), "cudaGraphGetNodes");
    nodes_.resize(count);
    if (count != 0) {
      ft::throw_on_error(cudaGraphGetNodes(graph_, nodes_.data(), &count), "cudaGraphGetNodes");
    }
  }
  captured(captured const&) = delete;
  captured& operator=(captured const&) = delete;
  ~captured() { static_cast<void>(cudaGraphDestroy(graph_)); }

  graph_counts counts() const {
    graph_counts c;
    for (auto const& node : nodes_) {
      switch (type_of(node)) {
        case cudaGraphNodeTypeKernel:
          ++c.kernels;
          break;
        case cudaGraphNodeTypeMemset:
          ++c.fills;
          break;
        case cudaGraphNodeTypeMemcpy: {
          ++c.copies;
          cudaMemcpy3DParms p = {};
          ft::throw_on_error(cudaGraphMemcpyNodeGetParams(node, &p),
                             "cudaGraphMemcpyNodeGetParams");
          std::size_t const bytes = p.extent.width * std::max<std::size_t>(p.extent.height, 1) *
                                    std::max<std::size_t>(p.extent.depth, 1);
          bool const from = on_device(p.srcPtr.ptr);
          bool const to = on_device(p.dstPtr.ptr);
          (from && to ? c.bytes_within : (to ? c.bytes_up : c.bytes_down)) += bytes;
          break;
        }
        default:
          ++c.others;
          break;
      }
    }
    return c;
  }

  /// One entry per kernel, in the order of their names.
  std::vector<kernel_facts> kernels() const {
    int device = 0;
    cudaDeviceProp properties;
    ft::throw_on_error(cudaGetDevice(&device), "cudaGetDevice");
    ft::throw_on_error(cudaGetDeviceProperties(&properties, device), "cudaGetDeviceProperties");
    std::map<void*, kernel_facts> found;
    for (auto const& node : nodes_) {
      if (type_of(node) != cudaGraphNodeTypeKernel) { continue; }
      cudaKernelNodeParams p = {};
      ft::throw_on_error(cudaGraphKernelNodeGetParams(node, &p), "cudaGraphKernelNodeGetParams");
      cudaFuncAttributes a = {};
      ft::throw_on_error(cudaFuncGetAttributes(&a, p.func), "cudaFuncGetAttributes");
      kernel_facts& k = found[p.func];
      ++k.launches;
      k.threads = static_cast<int>(p.blockDim.x * p.blockDim.y * p.blockDim.z);
      k.blocks = std::max(k.blocks, static_cast<int>(p.gridDim.x * p.gridDim.y * p.gridDim.z));
      k.registers = a.numRegs;
      k.shared = a.sharedSizeBytes;
      k.local = a.localSizeBytes;
      int blocks = 0;
      ft::throw_on_error(cudaOccupancyMaxActiveBlocksPerMultiprocessor(&blocks, p.func, k.threads,
                                                                       p.sharedMemBytes),
                         "cudaOccupancyMaxActiveBlocksPerMultiprocessor");
      k.threads_per_sm = blocks * k.threads;
      k.most_threads_sm = properties.maxThreadsPerMultiProcessor;
      if (k.name.empty()) { k.name = name_of_function(p.func, found.size()); }
    }
    std::vector<kernel_facts> all;
    for (auto const& entry : found) { all.push_back(entry.second); }
    std::sort(all.begin(), all.end(),
              [](kernel_facts const& a, kernel_facts const& b) { return a.name < b.name; });
    return all;
  }

private:
  static cudaGraphNodeType type_of(cudaGraphNode_t node) {
    cudaGraphNodeType type = cudaGraphNodeTypeEmpty;
    ft::throw_on_error(cudaGraphNodeGetType(node, &type), "cudaGraphNodeGetType");
    return type;
  }
  static bool on_device(void const* p) {
    cudaPointerAttributes a = {};
    ft::throw_on_error(cudaPointerGetAttributes(&a, p), "cudaPointerGetAttributes");
    return a.type == cudaMemoryTypeDevice;
  }
  static std::string name_of_function(void const* function, std::size_t number) {
#if CUDART_VERSION >= 12030
    char const* mangled = nullptr;
    if (cudaFuncGetName(&mangled, function) == cudaSuccess && mangled != nullptr) {
      int status = 0;
      char* const demangled = abi::__cxa_demangle(mangled, nullptr, nullptr, &status);
      std::string const name =
          status == 0 && demangled != nullptr ? short_kernel_name(demangled) : mangled;
      std::free(demangled);
      return name;
    }
    static_cast<void>(cudaGetLastError());
#else
    static_cast<void>(function);
#endif
    return "kernel " + std::to_string(number);
  }

  cudaGraph_t graph_ = nullptr;
  std::vector<cudaGraphNode_t> nodes_;
};

}  // namespace FT_ABI
}  // namespace bench

#endif
