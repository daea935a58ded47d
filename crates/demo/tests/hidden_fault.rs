//! Act two on the board's application in this process: what is hidden is found, and the tool gets what was
//! promised. Many seeds are a campaign of its own.

use trueup_demo::{act_two::act_two, boards::Boards, campaign::Campaign, hidden::Hidden};

#[test]
fn a_hidden_fault_is_named_and_another_day_is_better() {
    let hidden = Hidden::draw(1).expect("a machine that can be told");
    let two = act_two(&Boards::InProcess, &hidden, &mut |_, _| {}).expect("it runs through");
    let it = &two.outcome;
    println!("{}", it.line());
    assert!(it.all_right, "{}", it.line());
    assert!(it.board_s <= 600.0, "ten minutes of the board, not {} s", it.board_s);
    assert!(it.tool_rms_after_um < 0.5 * it.tool_rms_before_um, "{}", it.line());
    assert_eq!(
        two.second_day.len(),
        two.second_day.iter().filter(|row| row[2].is_finite()).count()
    );
}

#[test]
#[ignore = "campaign: cargo test -p trueup-demo --test hidden_fault campaign -- --ignored --show-output"]
fn campaign_of_fixed_seeds() {
    let seeds: u64 = std::env::var("SEEDS").ok().and_then(|it| it.parse().ok()).unwrap_or(200);
    let mut campaign = Campaign::default();
    for seed in 0..seeds {
        println!("{}", campaign.play(&Boards::InProcess, seed).expect("it runs through"));
    }
    println!("{}", campaign.text());
    let right = campaign.outcomes.iter().filter(|it| it.all_right).count();
    assert!(right > 0, "nothing was found");
}
