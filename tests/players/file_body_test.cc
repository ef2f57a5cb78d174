#include "clients/dashboard/file_body.h"

#include <gtest/gtest.h>
#include <unistd.h>

#include <fstream>

namespace secondskin::dashboard {
namespace {

namespace fs = std::filesystem;

class FileBodyTest : public testing::Test {
 protected:
  FileBodyTest() {
    std::string name = (fs::temp_directory_path() / "secondskin_XXXXXX").string();
    folder_ = ::mkdtemp(name.data());
    for (int i = 0; i < 300'000; ++i) content_ += static_cast<char>('a' + i % 23);
    std::ofstream(folder_ / "file", std::ios::binary) << content_;
  }
  ~FileBodyTest() override { fs::remove_all(folder_); }

  std::string read(FileBody& body) {
    std::string all;
    while (body.left() > 0) {
      const auto block = body.next();
      if (block.empty()) break;
      all.append(block.data(), block.size());
    }
    return all;
  }

  fs::path folder_;
  std::string content_;
};

// RFC 9110, 14.1.2: first and last position, both included; an open end; the last so many bytes.
TEST_F(FileBodyTest, GivesTheAskedRange) {
  const std::size_t size = content_.size();
  const auto expect = [&](const char* asked, std::size_t from, std::size_t count) {
    auto body = FileBody::open(folder_ / "file");
    ASSERT_TRUE(body);
    EXPECT_EQ(body->seek(asked), Range::kPart) << asked;
    EXPECT_EQ(body->left(), count) << asked;
    EXPECT_EQ(read(*body), content_.substr(from, count)) << asked;
  };
  expect("bytes=0-0", 0, 1);
  expect("bytes=10-200009", 10, 200'000);
  expect("bytes=299990-", 299'990, 10);
  expect("bytes=-5", size - 5, 5);
  expect("bytes=299999-900000", 299'999, 1);
  expect("bytes=-900000", 0, size);
}

TEST_F(FileBodyTest, GivesTheWholeForWhatIsNoSingleRange) {
  for (const char* asked : {"", "bytes=5-2", "bytes=0-1,4-5", "lines=1-2", "bytes=", "bytes=a-b",
                            "bytes=99999999999999999999-"}) {
    auto body = FileBody::open(folder_ / "file");
    ASSERT_TRUE(body);
    EXPECT_EQ(body->seek(asked), Range::kWhole) << asked;
    EXPECT_EQ(read(*body), content_) << asked;
  }
}

TEST_F(FileBodyTest, RefusesWhatLiesBehindTheEnd) {
  auto body = FileBody::open(folder_ / "file");
  EXPECT_EQ(body->seek("bytes=300000-"), Range::kUnsatisfiable);
  EXPECT_EQ(body->content_range(Range::kUnsatisfiable), "bytes */300000");
}

TEST_F(FileBodyTest, EndsWhenTheFileBecameShorter) {
  auto body = FileBody::open(folder_ / "file");
  fs::resize_file(folder_ / "file", 1000);
  EXPECT_EQ(read(*body).size(), 1000u);
  EXPECT_GT(body->left(), 0u);
}

TEST_F(FileBodyTest, OpensRegularFilesOnly) {
  EXPECT_FALSE(FileBody::open(folder_));
  EXPECT_FALSE(FileBody::open(folder_ / "none"));
  EXPECT_FALSE(FileBody::open("/dev/zero"));
}

}  // namespace
}  // namespace secondskin::dashboard
