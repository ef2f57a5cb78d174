#include "motion/whole_file.h"

#include <gmock/gmock.h>
#include <unistd.h>

#include <system_error>

namespace secondskin {
namespace {

namespace fs = std::filesystem;

class WholeFile : public testing::Test {
 protected:
  WholeFile() {
    std::string name = (fs::temp_directory_path() / "secondskin_XXXXXX").string();
    folder_ = ::mkdtemp(name.data());
  }
  ~WholeFile() override { fs::remove_all(folder_); }

  fs::path folder_;
};

TEST_F(WholeFile, IsReadAsItWasWritten) {
  for (const std::string& bytes : {std::string(), std::string("a\r\n\0\xff\n", 6)}) {
    write_whole_file(folder_ / "f", bytes);
    EXPECT_EQ(read_whole_file(folder_ / "f"), bytes);
  }
}

TEST_F(WholeFile, ThatCannotBeReadIsNamed) {
  fs::create_directory(folder_ / "d");
  for (const char* name : {"none", "d"}) {
    try {
      read_whole_file(folder_ / name);
      FAIL() << name;
    } catch (const std::system_error& error) {
      EXPECT_THAT(error.what(), testing::HasSubstr((folder_ / name).string()));
      EXPECT_NE(error.code().value(), 0);
    }
  }
}

}  // namespace
}  // namespace secondskin
