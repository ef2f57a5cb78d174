#include <cstdlib>
#include <new>

#include "tests/recording/mcap_files.h"

// In a file of its own, so that the compiler cannot pair these with the library's own operators.
namespace secondskin::recording::testing {
std::atomic<std::size_t> largest_request{0};
}

void* operator new(std::size_t size, const std::nothrow_t&) noexcept {
  auto& largest = secondskin::recording::testing::largest_request;
  if (size > largest) largest = size;
  return std::malloc(size);
}
void* operator new(std::size_t size) {
  if (void* memory = operator new(size, std::nothrow)) return memory;
  throw std::bad_alloc();
}
void operator delete(void* memory) noexcept { std::free(memory); }
void operator delete(void* memory, std::size_t) noexcept { std::free(memory); }
