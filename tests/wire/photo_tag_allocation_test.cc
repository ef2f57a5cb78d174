#include <gtest/gtest.h>

#include "tests/count_malloc.h"
#include "wire/photo_tag.h"

namespace secondskin::wire {
namespace {

TEST(TagDecoder, AllocatesNothingWhileItDecodes) {
#ifndef COUNTS_MALLOC
  GTEST_SKIP() << "the sanitizers bring their own malloc";
#else
  const TagFormat format;
  std::vector<std::uint8_t> stream;
  for (int i = 0; i < 100; ++i) {
    encode_set(format, std::vector<std::uint8_t>(format.values(), 1), stream);
    if (i % 3 == 0) stream.resize(stream.size() - 5);
  }
  TagDecoder decoder(format);
  std::uint64_t sum = 0;
  const TagDecoder::Sink sink = [&sum](const TagSet& set) { sum += set.values[0]; };
  const long before = allocations;
  for (std::size_t at = 0; at < stream.size(); at += 100) {
    const std::size_t count = std::min<std::size_t>(100, stream.size() - at);
    decoder.feed(std::span(stream).subspan(at, count), 0, sink);
    decoder.tick(1'000'000'000, sink);
  }
  decoder.finish(sink);
  EXPECT_EQ(allocations, before);
  EXPECT_GT(sum, 50U);
#endif
}

}  // namespace
}  // namespace secondskin::wire
