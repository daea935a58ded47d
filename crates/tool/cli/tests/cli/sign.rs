//! `trueup sign`: by itself and next to openssl, which others wrote.

use std::process::Command;

use crate::desk::Desk;

#[test]
fn a_file_is_signed_and_any_change_of_it_is_seen() {
    let desk = Desk::new(&[("a.bin", "calibration"), ("b.bin", "image")]);
    let (out, err) = desk.run_expecting("sign --new shop.pem", 0);
    assert!(out == "shop.pub.pem\n" && err.contains("can sign in your name"), "{out}{err}");
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt as _;
        let mode = desk.path("shop.pem").metadata().expect("the key").permissions().mode();
        assert_eq!(mode & 0o777, 0o600, "readable by its owner alone");
    }
    assert_eq!(
        desk.run_expecting("sign a.bin b.bin --key shop.pem", 0).0,
        "a.bin.sig\nb.bin.sig\n"
    );
    desk.run_expecting("sign a.bin b.bin --check shop.pub.pem", 0);

    desk.write("b.bin", "Image");
    let (out, err) = desk.run_expecting("sign a.bin b.bin --check shop.pub.pem", 3);
    assert!(out.contains("a.bin: signed") && err.contains("b.bin: the signature does not hold"));
    desk.write("c.bin", "");
    let (_, err) = desk.run_expecting("sign c.bin --check shop.pub.pem", 3);
    assert!(err.contains("c.bin: the signature is missing"), "{err}");
    desk.run_expecting("sign --new other.pem", 0);
    desk.run_expecting("sign a.bin --check other.pub.pem", 3);
}

#[test]
fn a_key_is_never_written_over_and_a_wrong_one_is_refused() {
    let desk = Desk::new(&[("a.bin", "calibration")]);
    desk.run_expecting("sign --new shop.pem", 0);
    let key = desk.text("shop.pem");
    desk.run_expecting("sign --new shop.pem", 2);
    assert_eq!(desk.text("shop.pem"), key);
    let (_, err) = desk.run_expecting("sign a.bin --key shop.pub.pem", 2);
    assert!(err.contains("shop.pub.pem: is no private key") && err.contains("--new"), "{err}");
    let (_, err) = desk.run_expecting("sign a.bin --check shop.pem", 2);
    assert!(err.contains("shop.pem: is no public key"), "{err}");
    let (_, err) = desk.run_expecting("sign a.bin", 2);
    assert!(err.contains("--key KEY.pem") && err.contains("--check"), "{err}");
    assert_eq!(desk.files("."), ["a.bin", "shop.pem", "shop.pub.pem"]);
}

/// openssl reads the keys, makes the same signature, and checks ours; without openssl nothing is compared.
#[test]
fn openssl_makes_and_checks_the_same_signatures() {
    let desk = Desk::new(&[("a.bin", "calibration")]);
    desk.run_expecting("sign --new shop.pem", 0);
    desk.run_expecting("sign a.bin --key shop.pem", 0);
    let openssl = |words: &str| {
        Command::new("openssl").args(words.split(' ')).current_dir(desk.path(".")).output()
    };
    let Ok(signed) = openssl("pkeyutl -sign -inkey shop.pem -rawin -in a.bin -out theirs.sig")
    else {
        trueup_output::write_diagnostic("skipped: openssl is not on this computer");
        return;
    };
    assert!(signed.status.success(), "{}", String::from_utf8_lossy(&signed.stderr));
    assert_eq!(desk.read("theirs.sig"), desk.read("a.bin.sig"));
    let check = "pkeyutl -verify -pubin -inkey shop.pub.pem -rawin -in a.bin -sigfile a.bin.sig";
    assert!(openssl(check).expect("it was there").status.success());
    desk.write("a.bin", "Calibration");
    assert!(!openssl(check).expect("it was there").status.success());
}
